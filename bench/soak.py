"""Run an installation for a month of simulated time; memory and disk have to stay flat.

    python -m bench soak [--days 30] [--cameras 20] [--events 6000] [--json FILE]

The spool, bus, journal and daemon are the real ones; the disk has to stay below the bounds that are
set. One simulated day of traffic is repeated with new times and numbers. Windows and retention are
short enough to be full after two days (memory) and five (disk), so that growth after that is a
leak. Every night the daemon stops and another starts on the same state, in the same process, which
has nothing else in it: its memory and its learner's are measured. At the end every event has to be
stored exactly once, and a plain learner given the same events has to have the same versions.
"""

from __future__ import annotations

import contextlib
import gc
import itertools
import multiprocessing
import random
import socket
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from bench.support.figures import line_of
from bench.support.parts import part_parser
from bench.support.site import resident
from camtopod.config.settings import BusSettings, Config, KeepSettings, Limits, StateSettings
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.serve.bus import Bus, dial
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox.publisher import SpoolPublisher
from camtopod.serve.outbox.spool import Spool
from camtopod.sim.settings import SimSettings
from camtopod.sim.simulation import simulate

DAY_SECONDS = 86_400.0
MEMORY_FROM_DAY, DISK_FROM_DAY = 2, 5
"""Days, from 1, at whose end windows and retention are full; the baseline for later days."""
GROWTH_MAX = 0.05
"""Largest growth that counts as flat."""
JOURNAL_BYTES, JOURNAL_EVENT_BYTES = 2 * 2**20, 300
"""Bound of the journal: bytes for versions and snapshots, and for each event of a day.

It is reached on the third day; retention by days alone would allow a third more.
"""
SPOOL_BYTES = 2**20
"""Bound of the spool: several days' events, so that it is full in the first days."""
BESIDE_BYTES = {"journal": 2**20, "spool": 5 * 2**18}
"""Bytes on disk beyond a bound: writes before its next check; the spool's log of 1 MiB."""
REACHED_SHARE = 0.8
"""Share of its bound that the disk has to reach; otherwise the bound is not tested."""
BATCH_SECONDS = 7200.0
"""Simulated seconds that come at once, cameras in any order; half the learner's lateness."""
WAIT_SECONDS = 300.0
"""Longest wait for an acknowledgement, a version or the end of a process, seconds."""
_PROCESSES = multiprocessing.get_context("spawn")


class Day(Struct):
    """State at the end of a simulated day, the first being 1; bytes, and seconds of wall time."""

    day: int
    resident: int
    journal: int
    spool: int
    version: int
    start_seconds: float
    seconds: float


def main(argv: list[str]) -> int:
    """Run the days; return 0 if memory and disk stayed flat and nothing was lost."""
    parser = part_parser(__name__, __doc__)
    parser.add_argument("--days", type=int, default=30)
    parser.add_argument("--cameras", type=int, default=20)
    parser.add_argument(
        "--events", type=int, default=6000, help="approximate number of events a day (default 6000)"
    )
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="append one line a day to this file"
    )
    arguments = parser.parse_args(argv)
    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.closing(Soak(Path(folder), arguments.cameras, arguments.events)) as soak,
    ):
        print("day  resident MiB  journal MiB  spool MiB  version  start s  day s")
        for day in range(1, arguments.days + 1):
            soak.run_day(day)
            d = soak.days[-1]
            sizes = "  ".join(
                f"{value / 2**20:11.2f}" for value in (d.resident, d.journal, d.spool)
            )
            print(
                f"{d.day:3}  {sizes}  {d.version:7}  {d.start_seconds:7.2f}  {d.seconds:5.0f}",
                flush=True,
            )
            if arguments.json is not None:
                with arguments.json.open("ab") as out:
                    out.write(msgspec.json.encode(d) + b"\n")
        wrong = [
            *growth_violations(soak.days),
            *bound_violations(soak.days, soak.bounds),
            *soak.wrong(),
        ]
    print("\n".join(wrong) or "flat, and nothing lost")
    return 1 if wrong else 0


def growth_violations(days: Sequence[Day]) -> Iterator[str]:
    """Yield a message for each size that grew after the day when it should have been full."""
    for name, since in (
        ("resident", MEMORY_FROM_DAY),
        ("journal", DISK_FROM_DAY),
        ("spool", DISK_FROM_DAY),
    ):
        if len(days) <= since:
            yield f"{name}: not tested, more than {since} days are needed"
            continue
        before = getattr(days[since - 1], name)
        largest = max(days[since:], key=lambda day: int(getattr(day, name)))
        size = getattr(largest, name)
        print(f"{name}: {size / before - 1.0:+.1%} at most since day {since}, on day {largest.day}")
        print(line_of(f"growth of {name}", size / before - 1.0))
        if size > (1.0 + GROWTH_MAX) * before:
            yield f"{name} has grown by more than {GROWTH_MAX:.0%}"


def bound_violations(days: Sequence[Day], bounds: Mapping[str, int]) -> Iterator[str]:
    """Yield a message for each size that exceeded its bound, or never came near it."""
    for name, bound in bounds.items():
        peak = max(days, key=lambda day: int(getattr(day, name)))
        size = getattr(peak, name)
        print(
            f"{name}: at most {size} bytes, on day {peak.day}; "
            f"its bound is {bound}, and {BESIDE_BYTES[name]} beyond it are allowed"
        )
        if size > bound + BESIDE_BYTES[name]:
            yield f"{name} has {size} bytes on day {peak.day}; its bound is {bound}"
        elif size < REACHED_SHARE * bound:
            yield f"{name} has never come near its bound, so the bound is not tested"


def miscounted(last_numbers: Mapping[str, int], counts: Counter[tuple[str, int]]) -> Iterator[str]:
    """Yield a message for events not stored exactly once; a camera's are numbered from 1."""
    events = {(camera, seq) for camera, last in last_numbers.items() for seq in range(1, last + 1)}
    losses, foreign = events - counts.keys(), counts.keys() - events
    duplicates = [event for event, times in counts.items() if times > 1]
    for fault, faulty in (
        ("lost", losses),
        ("stored more than once", duplicates),
        ("stored and never sent", foreign),
    ):
        if faulty:
            yield f"{len(faulty)} of {len(events)} events are {fault}, the first {min(faulty)}"


class WorkerProcess:
    """A process of its own that answers requests, one at a time."""

    def __init__(self, work: Callable[..., None], *arguments: Any) -> None:
        self._pipe, child_pipe = _PROCESSES.Pipe()
        self._process = _PROCESSES.Process(target=work, args=(child_pipe, *arguments))
        self._process.start()
        child_pipe.close()

    @property
    def resident(self) -> int:
        """Resident bytes of the process and its children."""
        assert self._process.pid is not None
        return resident(self._process.pid)

    def send(self, request: Any) -> None:
        """Send a request without waiting."""
        self._pipe.send(request)

    def receive(self) -> Any:
        """Return the answer to a request. Raises `EOFError` if the process has ended."""
        return self._pipe.recv()

    def ask(self, request: Any) -> Any:
        """Send a request and return its answer."""
        self.send(request)
        return self.receive()

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self._process.join(WAIT_SECONDS)


def run_daemons(pipe: Connection, config: Config, now: Any) -> None:
    """Run the daemons, one after the other, on the same state and by the clock ``now``."""
    daemon: Daemon | None = None
    with contextlib.suppress(EOFError):
        while True:
            match pipe.recv():
                case "start":
                    daemon = Daemon(config, clock=lambda: float(now.value))
                    pipe.send(daemon.start())
                case "status" if daemon is not None:
                    version = daemon.topology
                    pipe.send(
                        (
                            daemon.status().events.waiting,
                            (version.version, version.digest) if version else None,
                        )
                    )
                case ("newer", int(read)) if (
                    daemon is not None
                ):  # events of the journal from here on
                    newer = (
                        (n, entry)
                        for n, entry in daemon._journal.entries(read)
                        if entry and entry.kind == "event"
                    )
                    pipe.send([(number, event.camera, event.seq) for number, event in newer])
                case "tidy":  # collect reference cycles of earlier daemons
                    gc.collect()
                    pipe.send(True)
                case "stop" if daemon is not None:
                    daemon.stop()
                    pipe.send(True)
    if daemon is not None:
        daemon.stop()


def run_plain_learner(pipe: Connection, settings: Settings) -> None:
    """Run a plain learner that never stops; answer events with the versions they led to."""
    learner = Learner(settings, "site", "plain")
    with contextlib.suppress(EOFError):
        while True:
            for event in pipe.recv():
                learner.receive(event)
            pipe.send({version.version: version.digest for version in learner.updates()})


class Soak:
    """An installation and its days."""

    def __init__(self, folder: Path, cameras: int, events: int) -> None:
        learn = Settings(
            lateness_seconds=2 * BATCH_SECONDS,
            ahead_seconds_max=0.0,
            window_hours=24.0,
            refit_hours=4.0,
        )
        keep = KeepSettings(
            journal_days=3.0,
            history_days=3.0,
            journal_bytes_max=JOURNAL_BYTES + JOURNAL_EVENT_BYTES * events,
        )
        self._config = Config(
            bus=BusSettings(listen=(f"tcp/127.0.0.1:{_free_port()}",)),
            state=StateSettings(str(folder / "state")),
            learn=learn,
            keep=keep,
            limits=Limits(spool_bytes_max=SPOOL_BYTES),
        )
        self.bounds = {"journal": keep.journal_bytes_max, "spool": SPOOL_BYTES}
        rate = events / DAY_SECONDS / 12.0  # objects a second; each makes about twelve events
        day = SimSettings(seed=1, cameras=cameras, hours=23.5, objects_per_second=rate, rhythm=0.8)
        self._day, _ = simulate(day)
        self._now = _PROCESSES.Value("d", 0.0)
        self._home = WorkerProcess(run_daemons, self._config, self._now)
        self._twin = WorkerProcess(run_plain_learner, learn)
        self._expected: dict[int, str] = {}
        self._digests: dict[int, str] = {}
        self._last_numbers: Counter[str] = Counter()
        self._stored_counts: Counter[tuple[str, int]] = Counter()
        self._entries_read = 0  # entries of the journal
        self._bus: Bus | None = None
        self._spool = Spool(folder / "spool.db", "boot", 100_000, SPOOL_BYTES, kept_max=100_000)
        self._publisher = SpoolPublisher(self._spool)
        self._folder = folder
        self.days: list[Day] = []

    def run_day(self, day: int) -> None:
        """Start the daemon, publish the day's traffic, and stop the daemon."""
        start = time.perf_counter()
        self._home.ask("start")
        if self._bus is None:
            self._bus = dial(self._config)  # reconnects by itself after each night
            self._publisher.attach(self._bus)
        ready = time.perf_counter() - start

        # Publish in batches; the twin learns the same events.
        chance = random.Random(day)
        later = day * DAY_SECONDS + chance.uniform(0.0, 600.0)
        events = [msgspec.structs.replace(event, t=event.t + later) for event in self._day]
        for _, group in itertools.groupby(events, key=lambda event: event.t // BATCH_SECONDS):
            batch = list(group)
            self._now.value = batch[-1].t + 1.0
            self._twin.send(batch)
            self._publisher.publish(*batch)
            self._last_numbers.update(event.camera for event in batch)
            if not self._publisher.wait_stored(WAIT_SECONDS):
                raise TimeoutError("events are not stored")
            self._expected |= self._twin.receive()
            self._count()

        # Take the sizes.
        version, digest = self._learned()
        self._digests[version] = digest
        self._home.ask("tidy")
        memory = self._home.resident
        self._home.ask("stop")  # folds the journal's log in, whose size depends on the moment
        journal, spool = _bytes(self._folder / "state"), _bytes(self._folder, "spool")
        self.days.append(
            Day(day, memory, journal, spool, version, ready, time.perf_counter() - start)
        )

    def wrong(self) -> Iterator[str]:
        """Yield a message for lost events, and for versions unlike those of the plain learner."""
        yield from miscounted(self._last_numbers, self._stored_counts)
        differences = [
            version
            for version, digest in self._digests.items()
            if self._expected[version] != digest
        ]
        if differences:
            yield f"versions {differences} differ from those of an uninterrupted run"

    def close(self) -> None:
        """End all processes."""
        self._publisher.close()
        if self._bus is not None:
            self._bus.close()
        self._home.close()
        self._twin.close()
        self._spool.close()

    def _learned(self) -> tuple[int, str]:
        """Return the newest version and its digest, once the daemon is level with the twin."""
        deadline = time.monotonic() + WAIT_SECONDS
        while True:
            waiting_events, newest = self._home.ask("status")
            if waiting_events == 0 and newest is not None and newest[0] == max(self._expected):
                return int(newest[0]), str(newest[1])
            if time.monotonic() > deadline:
                raise TimeoutError("the daemon has not learned all events in time")
            time.sleep(0.02)

    def _count(self) -> None:
        """Count the new entries of the journal, before retention deletes them."""
        rows = self._home.ask(("newer", self._entries_read))
        for number, camera, seq in rows:
            self._entries_read = number
            self._stored_counts[camera, seq] += 1


def _free_port() -> int:
    """Return a port that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _bytes(folder: Path, prefix: str = "") -> int:
    """Return the size of the files in a folder whose names start with ``prefix``."""
    return sum(file.stat().st_size for file in folder.glob(f"{prefix}*") if file.is_file())
