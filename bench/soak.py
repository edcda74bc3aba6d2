"""A month in simulated time: the real spool, bus, journal and daemon, restarted every night; memory and disk have to
stay flat.

    python -m bench soak [--days 30] [--cameras 20] [--events 6000] [--json FILE]

One made-up day of traffic is repeated with new seconds and numbers. Windows and retention are short enough to be full
after two days (memory) and five (disk), so that whatever still grows then is a leak. Every night the daemon stops and
another starts on the same state, in the same process. At the end every event has been stored
once, and a plain learner given the same events has the same versions.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import os
import random
import socket
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
from msgspec import Struct

from bench._site import resident
from camtopod.config import BusSettings, Config, KeepSettings, Limits, StateSettings
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.records import Event
from camtopod.serve import memory
from camtopod.serve.bus import Bus, dial
from camtopod.serve.daemon import Daemon
from camtopod.serve.publisher import Publisher
from camtopod.serve.spool import Spool
from camtopod.sim.network import simulate
from camtopod.sim.settings import SimSettings

DAY_SECONDS = 86_400.0
MEMORY_FROM_DAY, DISK_FROM_DAY = 2, 5
"""Days at whose end windows and retention are full."""
GROWTH_MAX = 0.05
BATCH_EVENTS = 500
BATCH_SECONDS = 7200.0
"""Simulated time that comes at once, in any order of cameras; the learner is told to wait for as long."""
WAIT_SECONDS = 300.0


class Day(Struct):
    """How things are at the end of a simulated day. Bytes; seconds of wall time."""

    day: int
    resident: int
    journal: int
    spool: int
    version: int
    start_seconds: float
    seconds: float


def main(argv: list[str]) -> int:
    """Run the days; returns the exit status: 0 if memory and disk stayed flat and nothing was lost."""
    parser = argparse.ArgumentParser(prog="python -m bench soak", description="Many days in simulated time.")
    parser.add_argument("--days", type=int, default=30)
    parser.add_argument("--cameras", type=int, default=20)
    parser.add_argument("--events", type=int, default=6000, help="events a day, about (default 6000)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="one line a day goes here")
    given = parser.parse_args(argv)
    memory.limit_arenas()
    with tempfile.TemporaryDirectory() as folder:
        soak = Soak(Path(folder), given.cameras, given.events)
        print("day  resident MiB  journal MiB  spool MiB  version  start s  day s")
        for day in range(given.days):
            soak.live_through(day)
            d = soak.days[-1]
            sizes = "  ".join(f"{value / 2**20:11.2f}" for value in (d.resident, d.journal, d.spool))
            print(f"{d.day:3}  {sizes}  {d.version:7}  {d.start_seconds:7.2f}  {d.seconds:5.0f}", flush=True)
            if given.json is not None:
                with given.json.open("ab") as out:
                    out.write(msgspec.json.encode(d) + b"\n")
        wrong = [*grown(soak.days), *soak.wrong()]
    print("\n".join(wrong) or "flat, and nothing lost")
    return 1 if wrong else 0


def grown(days: Sequence[Day]) -> Iterator[str]:
    """What the last days have more of than the day when it should have been full."""
    for name, since in (("resident", MEMORY_FROM_DAY), ("journal", DISK_FROM_DAY), ("spool", DISK_FROM_DAY)):
        if len(days) <= since + 1:
            yield f"{name}: more than {since + 1} days are needed to tell"
            continue
        before, now = getattr(days[since], name), getattr(days[-1], name)
        print(f"{name}: {now / before - 1.0:+.1%} since day {since}")
        if now > (1.0 + GROWTH_MAX) * before:
            yield f"{name} has grown by more than {GROWTH_MAX:.0%}"


class Soak:
    """An installation and its days."""

    def __init__(self, folder: Path, cameras: int, events: int) -> None:
        learn = Settings(lateness_seconds=2 * BATCH_SECONDS, ahead_seconds_max=0.0, window_hours=24.0, refit_hours=4.0)
        keep = KeepSettings(journal_days=3.0, history_days=3.0, snapshot_events=2000)
        self._config = Config(
            bus=BusSettings(listen=(f"tcp/127.0.0.1:{_free_port()}",)), state=StateSettings(str(folder / "state")),
            learn=learn, keep=keep, limits=Limits(spool_kept_events=1000),
        )  # fmt: skip
        rate = events / DAY_SECONDS / 12.0  # objects a second; each makes about twelve events
        day = SimSettings(seed=1, cameras=cameras, hours=23.5, objects_per_second=rate, rhythm=0.8)
        self._day, _ = simulate(day)
        self._learner = Learner(learn, "site", "plain")
        self._expected: dict[int, str] = {}
        self._made: dict[int, str] = {}
        self._now = 0.0
        self._sent = self._stored = 0
        self._bus: Bus | None = None
        self._spool = Spool(folder / "spool.db", "boot", 100_000, kept_events_max=1000)
        self._publisher = Publisher(self._spool, BATCH_EVENTS)
        self._folder = folder
        self.days: list[Day] = []

    def live_through(self, day: int) -> None:
        """Start the daemon, let the day's traffic come, and stop it."""
        started = time.perf_counter()
        daemon = Daemon(self._config, clock=lambda: self._now)
        daemon.start()
        if self._bus is None:
            self._bus = dial(self._config)  # and reconnects by itself after each night
            self._publisher.attach(self._bus)
        ready = time.perf_counter() - started
        chance = random.Random(day)
        later = day * DAY_SECONDS + chance.uniform(0.0, 600.0)
        events = [msgspec.structs.replace(event, t=event.t + later) for event in self._day]
        for _, group in itertools.groupby(events, key=lambda event: event.t // BATCH_SECONDS):
            batch = list(group)
            self._now = batch[-1].t + 1.0
            self._publisher.publish(*batch)
            self._sent += len(batch)
            if not self._publisher.drained(WAIT_SECONDS):
                raise TimeoutError("events are not acknowledged")
            self._learn(batch)
        self._wait(lambda: daemon.status()["events"]["waiting"] == 0)
        self._wait(lambda: daemon.topology is not None and daemon.topology.version == max(self._expected))
        assert daemon.topology is not None
        self._made[daemon.topology.version] = daemon.topology.digest
        self._stored += daemon.status()["events"]["stored"]
        gc.collect()
        memory.give_back()  # what the plain learner beside the daemon took
        taken = resident(os.getpid())  # its learner is a process of its own
        daemon.stop()
        self.days.append(
            Day(
                day, taken, _bytes(self._folder / "state"), _bytes(self._folder, "spool"),
                daemon.topology.version, ready, time.perf_counter() - started,
            )
        )  # fmt: skip

    def wrong(self) -> Iterator[str]:
        """What the daemon lost, or learned otherwise than one that never stopped."""
        self._publisher.drained(WAIT_SECONDS)
        if self._stored != self._sent:
            yield f"{self._sent} events were sent and {self._stored} stored"
        other = [version for version, digest in self._made.items() if self._expected[version] != digest]
        if other:
            yield f"versions {other} differ from those of an uninterrupted run"
        if self._bus is not None:
            self._bus.close()
        self._spool.close()

    def _learn(self, batch: list[Event]) -> None:
        for event in batch:
            self._learner.receive(event)
        self._expected |= {one.version: one.digest for one in self._learner.updates()}

    def _wait(self, done: object) -> None:
        assert callable(done)
        deadline = time.monotonic() + WAIT_SECONDS
        while not done():
            if time.monotonic() > deadline:
                raise TimeoutError("the daemon does not learn")
            time.sleep(0.02)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _bytes(folder: Path, prefix: str = "") -> int:
    return sum(file.stat().st_size for file in folder.glob(f"{prefix}*") if file.is_file())
