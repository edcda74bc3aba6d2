"""A site that has learned, and the real `camtopod run` on it, for the parts that measure the
daemon.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
from msgspec import Struct

from camtopod.codec import to_json, to_pack
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.learn.snapshot import pack
from camtopod.records import Event
from camtopod.serve.runtime.clock import ulid, wall
from camtopod.serve.storage.journal import Entry, Journal, Snapshot, StoredVersion
from camtopod.sim.settings import SimSettings
from camtopod.sim.simulation import simulate

EVENTS_PER_OBJECT = 12.0
"""About so many events an object makes on its way through a made-up network of a hundred
cameras.
"""
WARM_SECONDS = 300.0
"""Of a simulation, until about as many leave the network as enter it."""
ONCE = Settings(refit_share=1e9, refit_hours=1e9)
"""Nothing falls due: the version is made when all has been learned."""
LEARNED_EVENTS, LEARNED_PER_SECOND_PER_CAMERA = 60_000, 0.1
"""What a site has learned from before anything is measured: its window is full."""
STOP_SECONDS = 20.0
LOOK_SECONDS = 0.02
"""Between two looks at how much memory there is."""


class Count(Struct, frozen=True):
    """What ``status/daemon`` says of the events, as far as it is asked here."""

    stored: int = 0
    received: int = 0
    lost: int = 0
    flood: int = 0
    held_full: int = 0
    waiting: int = 0


class Learned(Struct, frozen=True):
    """The newest version that the learner has made in this epoch; 0 before the first."""

    version: int = 0


class Status(Struct):
    """What of ``status/daemon`` is asked here."""

    events: Count = Count()
    learner: Learned = Learned()
    version: int = 0
    predictions: int = 0
    predictions_skipped: int = 0
    dropped: dict[str, int] = {}


def traffic(cameras: int, events_per_second: float, count: int) -> list[Event]:
    """So many events of a network in full swing, by time from 0; it is the same network at every
    rate.
    """
    seconds = WARM_SECONDS + 1.3 * count / events_per_second + 60.0
    while True:
        rate = events_per_second / EVENTS_PER_OBJECT
        made, _ = simulate(
            SimSettings(
                seed=1, cameras=cameras, hours=seconds / 3600.0, objects_per_second=rate, start=0.0
            )
        )
        swinging = [event for event in made if event.t >= WARM_SECONDS][:count]
        if len(swinging) == count:
            first = swinging[0].t
            return [msgspec.structs.replace(event, t=event.t - first) for event in swinging]
        seconds *= 1.5


def lay_out(state: Path, events: Sequence[Event]) -> None:
    """The state directory of a daemon that has learned these events, which ended a minute ago."""
    later = wall() - 60.0 - events[-1].t
    epoch = ulid(later)
    learner = Learner(ONCE, "site", epoch)
    entries, seqs = [], dict.fromkeys({event.camera for event in events}, 0)
    for event in events:
        seq = seqs[event.camera] = seqs[event.camera] + 1
        moved = msgspec.structs.replace(event, t=event.t + later, boot="before", seq=seq)
        learner.receive(moved)
        entries.append(Entry("event", event.camera, "before", seq, to_pack(moved)))
    learner.flush()
    journal = Journal(state)
    journal.set_meta("epoch", epoch)
    journal.commit(entries)
    made = learner.updates()
    journal.commit(
        [], [StoredVersion(one.epoch, one.version, one.digest, to_json(one)) for one in made]
    )
    journal.commit([], snapshot=Snapshot(len(entries), epoch, pack(learner.save())))
    journal.close()


def learned_site(folder: Path, cameras: int, count: int) -> Path:
    """The state directory of a site of so many cameras and events, made if it is not there yet."""
    state = folder / f"learned-{cameras}-{count}"
    if not state.exists():
        lay_out(folder / "making", traffic(cameras, LEARNED_PER_SECOND_PER_CAMERA * cameras, count))
        (folder / "making").rename(state)
    return state


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``--cameras``, ``--learned`` and ``--site``."""
    parser.add_argument("--cameras", type=int, default=100)
    parser.add_argument(
        "--learned", type=int, default=LEARNED_EVENTS, help="events the site has learned before"
    )
    parser.add_argument(
        "--site", type=Path, help="folder to keep the site in that has learned, for the next time"
    )


@contextlib.contextmanager
def running(folder: Path, learn: str = "", limits: str = "") -> Iterator[tuple[str, int]]:
    """`camtopod run` on ``folder``/state in a process of its own: its endpoint and process id.
    ``learn`` and ``limits`` are lines of these tables.
    """
    config = folder / "camtopod.toml"
    config.write_text(
        f'[bus]\nlisten = ["tcp/127.0.0.1:0"]\n[state]\ndirectory = "{folder}/state"\n[learn]\n{learn}\n'
        f"[limits]\n{limits}\n"
    )
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "camtopod", "--config", str(config), "run"]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(command, stderr=log, env=environment)
    try:
        yield _endpoint(process, folder / "log"), process.pid
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(STOP_SECONDS)


def _endpoint(process: subprocess.Popen[bytes], log: Path) -> str:
    """Where it says that it is ready."""
    while process.poll() is None:
        for line in log.read_text().splitlines():
            if "ready at " in line:
                return line.rpartition("ready at ")[2].strip()
        time.sleep(0.05)
    raise RuntimeError(f"the daemon ended instead of becoming ready: {log.read_text()}")


def resident(pid: int, most: bool = False) -> int:
    """Bytes in memory of a process and its children, now or at ``most`` so far."""
    total = 0
    for process in (pid, *_children(pid)):
        with contextlib.suppress(OSError):
            lines = Path(f"/proc/{process}/status").read_text().splitlines()
            [kilobytes] = [
                line.split()[1] for line in lines if line.startswith("VmHWM:" if most else "VmRSS:")
            ]
            total += 1024 * int(kilobytes)
    return total


@contextlib.contextmanager
def most_at_once(pid: int) -> Iterator[list[int]]:
    """While the block runs it is looked how much a process and its children have in memory at one
    moment: the most so far is the only element of the list, in bytes. Pages of files that several
    of them have are counted once, as the system has them once; how many these are is looked up at
    the end.
    """
    most, ended = [0], threading.Event()

    def look() -> None:
        while not ended.wait(LOOK_SECONDS):
            most[0] = max(most[0], resident(pid))

    looking = threading.Thread(target=look)
    looking.start()
    try:
        yield most
        again = _counted_again((pid, *_children(pid)))
    finally:
        ended.set()
        looking.join()
    most[0] -= again


def _counted_again(processes: Sequence[int]) -> int:
    """Bytes of files that more than one of the processes have in memory, beyond the first."""
    sizes: dict[tuple[str, ...], list[int]] = {}
    for process in processes:
        mapping: tuple[str, ...] = ()
        for line in Path(f"/proc/{process}/smaps").read_text().splitlines():
            name, *columns = line.split()
            if not name.endswith(":"):  # addresses: permissions, offset, device, inode and path
                mapping = tuple(columns[:4])
                sizes.setdefault(mapping, []).append(0)
            elif name in {"Rss:", "Anonymous:"}:  # what was written to is the process's own
                sizes[mapping][-1] += 1024 * int(columns[0]) * (1 if name == "Rss:" else -1)
    return sum(sum(each) - max(each) for mapping, each in sizes.items() if mapping[-1] != "0")


def _children(pid: int) -> list[int]:
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            found += [int(child) for child in task.read_text().split()]
    return found
