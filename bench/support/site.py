"""A site that has learned, and the real `camtopod run` on it, to measure the daemon."""

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
from typing import Any

import msgspec

from camtopod.codec import to_json, to_msgpack
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.learn.snapshot import pack
from camtopod.records import Event
from camtopod.serve.runtime.clock import ulid, wall
from camtopod.serve.storage.journal import Entry, Journal, Snapshot, StoredVersion
from camtopod.sim.settings import SimSettings
from camtopod.sim.simulation import simulate

EVENTS_PER_OBJECT = 12.0
"""Events of one object on its path through a simulated network of a hundred cameras, about."""
WARM_SECONDS = 300.0
"""Simulated seconds until about as many objects leave the network as enter it."""
ONCE = Settings(refit_share=1e9, refit_hours=1e9)
"""Settings with which no version falls due; one is made when all has been learned."""
BEFORE = "before"
"""Boot of the events that a site has learned before anything is measured."""
LEARNED_EVENTS, LEARNED_PER_SECOND_PER_CAMERA = 60_000, 0.1
"""Events (and their rate) that a site learns before anything is measured; they fill its window."""
HERE = Path(__file__).parents[2]
"""This checkout."""
UNIT = HERE / "deploy" / "camtopod.service"
"""The unit whose environment a measured daemon gets."""
PROGRAM = ("-m", "camtopod")
"""What Python runs as the daemon."""
STOP_SECONDS = 20.0
"""Longest wait for the daemon to stop, seconds."""
LOOK_SECONDS = 0.02
"""Interval at which memory is sampled, seconds."""


def traffic(cameras: int, events_per_second: float, count: int) -> list[Event]:
    """Return ``count`` events of a network in its steady state, by time from 0.

    The network is the same at every rate.
    """
    seconds = WARM_SECONDS + 1.3 * count / events_per_second + 60.0
    while True:
        rate = events_per_second / EVENTS_PER_OBJECT
        events, _ = simulate(
            SimSettings(
                seed=1, cameras=cameras, hours=seconds / 3600.0, objects_per_second=rate, start=0.0
            )
        )
        swinging = [event for event in events if event.t >= WARM_SECONDS][:count]
        if len(swinging) == count:
            first = swinging[0].t
            return [msgspec.structs.replace(event, t=event.t - first) for event in swinging]
        seconds *= 1.5


def lay_out(state: Path, events: Sequence[Event], site: str = "site") -> None:
    """Write the state directory of a site's daemon that has learned these events.

    Their times are moved so that the last event is a minute old, and their boot is `BEFORE`.
    """
    later = wall() - 60.0 - events[-1].t
    epoch = ulid(later)
    learner = Learner(ONCE, site, epoch)

    # Number the events and learn them.
    entries, seqs = [], dict.fromkeys({event.camera for event in events}, 0)
    for event in events:
        seq = seqs[event.camera] = seqs[event.camera] + 1
        moved_event = msgspec.structs.replace(event, t=event.t + later, boot=BEFORE, seq=seq)
        learner.receive(moved_event)
        entries.append(Entry("event", event.camera, BEFORE, seq, to_msgpack(moved_event)))
    learner.flush()

    # Journal, versions and snapshot.
    journal = Journal(state)
    journal.set_meta("epoch", epoch)
    journal.commit(entries)
    versions = learner.updates()
    journal.commit([], [StoredVersion(v.epoch, v.version, v.digest, to_json(v)) for v in versions])
    journal.commit([], snapshot=Snapshot(len(entries), epoch, pack(learner.save())))
    journal.close()


def learned_site(folder: Path, cameras: int, count: int) -> Path:
    """Return the state directory of a site of this size, made if it is missing."""
    state = folder / f"learned-{cameras}-{count}"
    if not state.exists():
        lay_out(folder / "making", traffic(cameras, LEARNED_PER_SECOND_PER_CAMERA * cameras, count))
        (folder / "making").rename(state)
    return state


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``--cameras``, ``--learned`` and ``--site``."""
    parser.add_argument("--cameras", type=int, default=100)
    parser.add_argument(
        "--learned",
        type=int,
        default=LEARNED_EVENTS,
        help="events that the site has learned before",
    )
    parser.add_argument(
        "--site", type=Path, help="folder to keep the learned site in, for later runs"
    )


def in_checkout(checkout: Path) -> dict[str, Any]:
    """Return the arguments of `subprocess` that run `PROGRAM` by the source of a checkout."""
    return {"cwd": checkout, "env": os.environ | {"PYTHONPATH": str(checkout)}}


@contextlib.contextmanager
def running(
    folder: Path, learn: str = "", limits: str = "", bus: str = "", checkout: Path = HERE
) -> Iterator[tuple[str, int]]:
    """Run `camtopod run` on ``folder``/state in a process of its own; yield endpoint and process
    id.

    ``learn``, ``limits`` and ``bus`` are lines of these tables of the configuration; ``checkout``
    has the source of the daemon.
    """
    config = folder / "camtopod.toml"
    config.write_text(
        f'[bus]\nlisten = ["tcp/127.0.0.1:0"]\n{bus}\n[state]\ndirectory = "{folder}/state"\n'
        f"[learn]\n{learn}\n[limits]\n{limits}\n"
    )
    lines = UNIT.read_text().splitlines()
    settings = [line.removeprefix("Environment=") for line in lines if "Environment=" in line]
    place = in_checkout(checkout)
    place["env"] |= dict(pair.split("=") for pair in " ".join(settings).split())
    command = [sys.executable, *PROGRAM, "--config", str(config), "run"]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(command, stderr=log, **place)
    try:
        yield _endpoint(process, folder / "log"), process.pid
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(STOP_SECONDS)


def _endpoint(process: subprocess.Popen[bytes], log: Path) -> str:
    """Wait for the daemon's ready message and return its endpoint."""
    while process.poll() is None:
        for line in log.read_text().splitlines():
            if "ready at " in line:
                return line.rpartition("ready at ")[2].strip()
        time.sleep(0.05)
    raise RuntimeError(f"the daemon ended before it was ready: {log.read_text()}")


def resident(pid: int, peak: bool = False) -> int:
    """Return the resident bytes of a process and its children, or their added peaks (``peak``)."""
    total = 0
    for process in (pid, *children(pid)):
        with contextlib.suppress(OSError):
            lines = Path(f"/proc/{process}/status").read_text().splitlines()
            [kilobytes] = [
                line.split()[1] for line in lines if line.startswith("VmHWM:" if peak else "VmRSS:")
            ]
            total += 1024 * int(kilobytes)
    return total


@contextlib.contextmanager
def peak_memory(pid: int) -> Iterator[list[int]]:
    """Track the peak memory of a process and its children while the block runs.

    Yields a list whose only element is the peak in bytes. Pages of files that several processes
    have mapped count once; their size is measured at the end of the block and subtracted.
    """
    peak, stop = [0], threading.Event()

    def look() -> None:
        while not stop.wait(LOOK_SECONDS):
            peak[0] = max(peak[0], resident(pid))

    looking = threading.Thread(target=look)
    looking.start()
    try:
        yield peak
        again = _counted_again((pid, *children(pid)))
    finally:
        stop.set()
        looking.join()
    peak[0] -= again


def _counted_again(processes: Sequence[int]) -> int:
    """Return the bytes of files that several of the processes have mapped, beyond the first."""
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
    return sum(sum(counts) - max(counts) for mapping, counts in sizes.items() if mapping[-1] != "0")


def processor_seconds(*pids: int) -> float:
    """Return the processor time of processes so far, in seconds."""
    fields = [Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split() for pid in pids]
    return sum(int(columns[11]) + int(columns[12]) for columns in fields) / os.sysconf("SC_CLK_TCK")


def children(pid: int) -> list[int]:
    """Return the process ids of the children."""
    pids: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            pids += [int(child) for child in task.read_text().split()]
    return pids
