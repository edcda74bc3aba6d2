"""kill -9 of daemons, routers and publishers of a city's districts, one at a time.

Afterwards each site has stored every event of the cameras that it hears once, and the exits of all
districts of which nothing was killed were predicted without a pause.
"""

from __future__ import annotations

import contextlib
import math
import random
import sqlite3
import subprocess
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

import pytest
from grabber import stored
from msgspec.structs import replace
from real_daemon import READY_SECONDS, RealDaemon, script
from serving import AT_ONCE, camtopod, free_endpoint, wait_for
from sizes import size
from traffic import events_ever_in

from bench.support.site import BEFORE, lay_out
from camtopod import codec
from camtopod.city.partition import partition
from camtopod.cli.city import deployment
from camtopod.config import District, Districts, with_borders
from camtopod.config.config_file import load
from camtopod.records import Event, Prediction
from camtopod.serve.bus import Bus, dial
from camtopod.serve.outbox import spool_path
from camtopod.serve.storage import Journal
from camtopod.sim.settings import SimSettings
from camtopod.sim.simulation import simulate
from camtopod.topology import camera_of

PROGRAMS = ("daemon", "router", "publisher")
EVENTS_PER_OBJECT = 8.3
"""Events of an object that enters a simulated city, about."""
LEARNED_EVENTS = 1_500
"""Events that the daemon of a district has learned before, on average."""
START_SECONDS_MAX = 300.0
"""Longest wait for a district to predict, seconds."""
DELAY_SECONDS_MAX = 2.0
"""Longest time from an exit to its prediction in a district of which nothing was killed, seconds.

Half of the programs that are killed are away for longer.
"""
MARGIN_SECONDS = 1.0
"""Exits so long before a kill may have been on their way."""

Key = tuple[str, float, str | None]
"""Camera, time and track of an exit."""


def city_of(
    cameras: int, cameras_max: int, rate: float, seconds: float
) -> tuple[Districts, list[Event]]:
    """Return the districts of a simulated city, and its events, by time from 0.

    rate: events a second in all.
    """
    events, truth = simulate(
        SimSettings(
            seed=1,
            cameras=cameras,
            hours=seconds / 3600.0,
            objects_per_second=rate / EVENTS_PER_OBJECT,
            start=0.0,
        )
    )
    passages = Counter[tuple[str, str]]()
    for link in truth.links:
        a, b = sorted((camera_of(link.from_), camera_of(link.to)))
        if a != b:
            passages[a, b] += link.transitions
    owners = partition(truth.cameras, passages, cameras_max)
    return with_borders(owners, [pair.cameras for pair in truth.pairs]), events


class Site:
    """The router, the daemon and the publisher of a district, as processes, and its predictions.

    text: configuration of daemon and publisher.
    router: configuration of the router.
    """

    def __init__(
        self,
        name: str,
        folder: Path,
        district: District,
        text: str,
        router: str,
        constants: Mapping[str, object],
    ) -> None:
        folder.mkdir()
        self.name = name
        self.folder = folder
        self.district = district
        self.heard_cameras = {*district.cameras, *district.hears}
        self.predictions: dict[Key, float] = {}
        """When the prediction of each exit came."""
        self.outages: list[tuple[float, float]] = [(0.0, math.inf)]
        """Times from which on its predictions were, and were not, interrupted."""
        self._newest = 0.0  # time of the newest exit of its own that was predicted
        self._text = text
        self._constants = constants
        self._events: list[Event] = []
        self._processes: dict[str, list[subprocess.Popen[bytes]]] = {}
        self._daemon: RealDaemon | None = None
        self._bus: Bus | None = None
        (folder / "router.json5").write_text(router)

    def start_daemon(self, learned: list[Event]) -> None:
        """Start the router and the daemon, which has learned events; subscribe to predictions."""
        lay_out(self.folder / "state", learned, self.name)
        self.start("router")
        self.start("daemon")
        self._bus = dial(load(self.folder / "camtopod.toml"))
        self._bus.subscribe("prediction/*", self._hear)

    def start_publisher(self, events: list[Event]) -> None:
        """Start to publish the events of its own cameras when their times come."""
        self._events = events
        lines = b"".join(codec.to_json(event) + b"\n" for event in events)
        (self.folder / "events.jsonl").write_bytes(lines)
        self.start("publisher")

    def start(self, program: str) -> None:
        """Start a program."""
        if program == "router":
            router = script("traffic.py", "zenohd", self.folder / "router.json5")
            self._processes[program] = [router]
            assert router.stdout is not None
            assert router.stdout.readline() == b"ready\n"
        elif program == "daemon":
            self._daemon = RealDaemon(
                self.folder, self._text, START_SECONDS_MAX, constants=self._constants
            )
            self._processes[program] = [self._daemon.process]
        else:
            config = self.folder / "camtopod.toml"
            recording = self.folder / "events.jsonl"
            lines = script("traffic.py", "play", recording, len(self.published))
            ingest = camtopod("--config", str(config), "ingest", "jsonl", stdin=lines.stdout)
            self._processes[program] = [ingest, lines]

    def kill(self, program: str) -> None:
        """End a program with SIGKILL."""
        for process in self._processes.pop(program):
            process.kill()
            process.wait(READY_SECONDS)
            if process.stdout is not None:
                process.stdout.close()
        if program == "daemon":
            assert self._daemon is not None
            self._daemon.close()

    def kill_and_restart(self, program: str, pause: float) -> None:
        """Kill a program, start it again after ``pause`` seconds, and wait for predictions."""
        began = time.time()
        self.outages.append((began - MARGIN_SECONDS, math.inf))
        self.kill(program)
        time.sleep(pause)
        self.start(program)
        self.await_predictions()

    def await_predictions(self) -> None:
        """Wait for the prediction of an exit that is still to come; this ends an outage."""
        began = time.time()
        try:
            wait_for(lambda: self._newest > began, f"predictions of {self.name}", START_SECONDS_MAX)
        except AssertionError:
            print(f"the daemon of {self.name}:", *(self._daemon.said if self._daemon else ()))
            raise
        self.outages[-1] = (self.outages[-1][0], time.time())

    def finish(self) -> None:
        """End the events, and wait until all are stored in all sites of their cameras."""
        self.outages.append((time.time() - MARGIN_SECONDS, math.inf))
        ingest, lines = self._processes["publisher"]
        lines.terminate()
        assert ingest.wait(START_SECONDS_MAX) == 0

    @property
    def published(self) -> list[Event]:
        """The events that its publisher has had."""
        spool = spool_path(self.folder / "state", self.name, "ingest")
        return self._events[: events_ever_in(spool)]

    def delays(self) -> Iterator[float]:
        """Yield the seconds from each exit of its own cameras to its prediction, except outages."""
        for event in self.published:
            during = any(start <= event.t <= end for start, end in self.outages)
            if event.kind == "exit" and not during:
                key = (event.camera, event.t, event.track)
                yield self.predictions.get(key, math.inf) - event.t

    def close(self) -> None:
        """End everything."""
        for program in list(self._processes):
            self.kill(program)
        if self._bus is not None:
            self._bus.close()

    def _hear(self, key: str, payload: bytes) -> None:
        exit_ = codec.read(Prediction, payload, pack=True)
        self.predictions.setdefault((exit_.camera, exit_.t, exit_.track), time.time())
        if exit_.camera in self.district.cameras:
            self._newest = max(self._newest, exit_.t)


class City:
    """Districts on one machine, as `camtopod districts --deploy systemd` configures them.

    recording: events by time from 0. The daemons have learned those before ``learn_seconds``; the
        others are published at their pace.
    """

    def __init__(
        self,
        folder: Path,
        districts: Districts,
        recording: list[Event],
        learn_seconds: float,
        constants: Mapping[str, object],
    ) -> None:
        self._recording = recording
        self._learn_seconds = learn_seconds
        texts = deployment.texts_of("systemd", districts)
        for number in range(len(districts)):
            port, free = f"127.0.0.1:{deployment.ROUTER_PORT + number}", free_endpoint()[4:]
            texts = {file: text.replace(f'{port}"', f'{free}"') for file, text in texts.items()}
        self.sites = {
            name: Site(
                name,
                folder / label,
                districts[name],
                texts[f"{label}.toml"],
                texts[f"{label}.router.json5"],
                constants,
            )
            for label, name in deployment.names_by_label(districts).items()
        }

    def start(self) -> None:
        """Start everything, and wait until all districts predict."""
        learned = [event for event in self._recording if event.t < self._learn_seconds]
        for site in self.sites.values():
            site.start_daemon([event for event in learned if event.camera in site.heard_cameras])
        later = time.time() - self._learn_seconds
        for site in self.sites.values():
            site.start_publisher(
                [
                    replace(event, t=event.t + later)
                    for event in self._recording[len(learned) :]
                    if event.camera in site.district.cameras
                ]
            )
        for site in self.sites.values():
            site.await_predictions()

    def kill_in_turn(self, seed: int, kills: float, seconds: float) -> Counter[str]:
        """Kill each kind of program in turn, in random districts; return how often which was.

        It ends after so many kills, or so many seconds.
        """
        chance = random.Random(seed)
        killed = Counter[str]()
        ends = time.monotonic() + seconds
        while killed.total() < kills and time.monotonic() < ends:
            program = PROGRAMS[killed.total() % len(PROGRAMS)]
            name = chance.choice(list(self.sites))
            pause = chance.choice((0.0, 1.5 * DELAY_SECONDS_MAX))
            began = time.monotonic()
            self.sites[name].kill_and_restart(program, pause)
            killed[program] += 1
            print(f"{killed.total()} {program} of {name}, {time.monotonic() - began:.1f} s")
        return killed

    def finish(self) -> None:
        """Wait until all is stored, and end everything."""
        for site in self.sites.values():
            site.finish()
        self.close()

    def lost_and_doubled(self) -> tuple[int, int]:
        """Return the numbers of lost and of duplicated events in the journals of all sites."""
        lost = doubled = 0
        events = [event for site in self.sites.values() for event in site.published]
        for site in self.sites.values():
            made = Counter(_key(event) for event in events if event.camera in site.heard_cameras)
            journal = [codec.event_from_msgpack(raw) for _, raw in stored(site.folder / "state")]
            found = Counter(_key(event) for event in journal if event.boot != BEFORE)
            lost += (made - found).total()
            doubled += (found - made).total()
        return lost, doubled

    def close(self) -> None:
        """End everything."""
        for site in self.sites.values():
            site.close()


def _key(event: Event) -> tuple[str, float, str, str]:
    return (event.camera, event.t, event.kind, str(event.track))


@contextlib.contextmanager
def running(
    folder: Path,
    districts: int,
    cameras: int,
    rate: float,
    seconds: float,
    constants: Mapping[str, object] = MappingProxyType({}),
) -> Iterator[City]:
    """Run a city whose events last so many ``seconds`` after its start.

    cameras: mean number of cameras of a district.
    rate: events a second in all.
    """
    learn_seconds = LEARNED_EVENTS * districts / rate
    lasts = learn_seconds + START_SECONDS_MAX + seconds
    parts, recording = city_of(districts * cameras, cameras * 6 // 5, rate, lasts)
    with contextlib.closing(City(folder, parts, recording, learn_seconds, constants)) as city:
        city.start()
        yield city


def check(city: City, delay_max: float) -> None:
    """End a city; check that each site has all events once, and predicted within ``delay_max``."""
    city.finish()
    lost, doubled = city.lost_and_doubled()
    events = sum(len(site.published) for site in city.sites.values())
    delays = sorted(delay for site in city.sites.values() for delay in site.delays())
    print(
        f"{events} events, {len(delays)} exits; to the prediction: median "
        f"{delays[len(delays) // 2]:.3f} s, 99 % {delays[len(delays) * 99 // 100]:.3f} s, "
        f"longest {delays[-1]:.2f} s"
    )
    assert (lost, doubled) == (0, 0)
    assert delays[-1] < delay_max


@pytest.mark.campaign
def test_kills_in_one_district_do_not_reach_another(tmp_path: Path) -> None:
    with running(tmp_path, 2, 6, 30.0, 60.0, constants=AT_ONCE) as city:
        city.kill_in_turn(6, len(PROGRAMS), 60.0)

        check(city, DELAY_SECONDS_MAX)

    # The canary: an event that was not stored in one of its sites, and one that was stored twice.
    name, site = next(iter(city.sites.items()))
    with contextlib.closing(sqlite3.connect(site.folder / "state" / "journal.db")) as database:
        database.execute(
            "DELETE FROM entry WHERE id = (SELECT MAX(id) FROM entry WHERE kind = 'event')"
        )
        database.commit()
    with contextlib.closing(Journal(site.folder / "state")) as journal:
        *_, entry = (entry for _, entry in journal.entries() if entry and entry.kind == "event")
        journal.commit([replace(entry, boot="again")])
    assert city.lost_and_doubled() == (1, 1), name


@pytest.mark.campaign
@pytest.mark.timeout(7200)
def test_many_kills_in_a_city(tmp_path: Path) -> None:
    districts, cameras = size("DISTRICTS", 20), size("DISTRICT_CAMERAS", 100)
    rate, seconds = size("CITY_EVENTS", 200), size("CITY_SECONDS", 600)
    with running(tmp_path, districts, cameras, rate, seconds + 60.0) as city:
        print("cameras:", *(len(site.district.cameras) for site in city.sites.values()))
        killed = city.kill_in_turn(size("SEED", 1), size("CITY_KILLS", 10**6), seconds)

        check(city, DELAY_SECONDS_MAX)
        print(killed)
