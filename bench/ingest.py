"""Measure how fast a recording is stored, beside bare zenoh and SQLite, and another checkout.

    python -m bench ingest [--base FOLDER] [--cameras 100] [--events 100000] [--rounds 5]
        [--json FILE]

A process delivers the events of a recording, three days old, to another, which stores and answers.
``spools``: to `camtopod run`, in requests as those of a spool for each camera. ``camtopod ingest``:
the same from a file of event lines, from the start of the command to its end. ``bare``: requests of
the same size over zenoh alone, each committed to SQLite as one blob and answered; no program on
these two can be faster. A round is valid only if each event was stored once. FOLDER is another
checkout, made by ``git worktree add FOLDER COMMIT``.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec

import bench
from bench.support import ratios
from bench.support.clients import client, ready_at, result, status_of, write_events
from bench.support.figures import line_of
from bench.support.parts import part_parser
from bench.support.site import PROGRAM, in_checkout, peak_memory, running, traffic
from camtopod.codec import to_json

BARE, SPOOLS, FILE = "bare", "spools", "camtopod ingest"
"""Names of the contestants; those of the base have `OF_BASE` at the end."""
OF_BASE = " of the base"
TIME_MAX, MEMORY_MAX = 0.2, 1.5
"""Targets: largest ratio to the base."""
EVENTS_PER_SECOND_PER_CAMERA = 0.1
"""Density of the recording, events a second and camera."""
AGE_SECONDS = 3 * 86_400.0
"""Age of the last event."""

Peaks = defaultdict[str, list[float]]
"""Megabytes of daemon and learner at their peak, in each round, by contestant."""


class Lost(RuntimeError):
    """Raised if not every event has been stored."""


def main(argv: list[str]) -> int:
    """Measure and return the exit status."""
    parser = part_parser(__name__, __doc__)
    parser.add_argument("--base", type=Path, metavar="FOLDER")
    parser.add_argument("--cameras", type=int, default=100)
    parser.add_argument("--events", type=int, default=100_000)
    ratios.add_arguments(parser, rounds=5)
    arguments = parser.parse_args(argv)
    checkouts = {"": Path(bench.__path__[0]).parent}
    if arguments.base:
        checkouts[OF_BASE] = arguments.base.resolve()
    peaks: Peaks = defaultdict(list)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        events = recording(folder, arguments.cameras, arguments.events)
        contestants: dict[str, Callable[[], float]] = {BARE: partial(bare, folder, events)}
        for suffix, checkout in checkouts.items():
            for way, deliver in ((SPOOLS, spools), (FILE, ingest)):
                delivery = partial(deliver, folder, checkout)
                peak = peaks[way + suffix]
                contestants[way + suffix] = partial(
                    stored, folder, checkout, arguments.events, delivery, peak
                )
        costs = ratios.take_turns(contestants, arguments.rounds)

    title = f"{arguments.events} events of {arguments.cameras} cameras"
    tables = [ratios.compare(title, "us an event", costs, BARE)]
    for way in (SPOOLS, FILE) if arguments.base else ():
        pair = (way + OF_BASE, way)
        tables.append(
            ratios.compare(
                way, "us an event", {name: costs[name] for name in pair}, pair[0], {way: TIME_MAX}
            )
        )
        megabytes = {name: peaks[name][ratios.WARM_ROUNDS :] for name in pair}
        tables.append(ratios.compare(f"{way}: memory", "MB", megabytes, pair[0], {way: MEMORY_MAX}))
    print("\n".join(line for table in tables for line in ratios.lines(table)))
    for row in tables[0].rows:
        print(line_of(f"events/s, {row.name}", 1e6 / row.cost.median))
    ratios.write(
        arguments.json, "ingest", tables, cameras=arguments.cameras, events=arguments.events
    )
    return 0


def recording(folder: Path, cameras: int, count: int) -> str:
    """Write a recording as event lines and as one message; return the path of the message."""
    events = traffic(cameras, EVENTS_PER_SECOND_PER_CAMERA * cameras, count)
    later = time.time() - AGE_SECONDS - events[-1].t
    recent = [msgspec.structs.replace(event, t=event.t + later) for event in events]
    (folder / "events.jsonl").write_bytes(b"".join(to_json(event) + b"\n" for event in recent))
    return write_events(folder / "events", recent)


def bare(folder: Path, events: str) -> float:
    """Return the microseconds an event that is sent, committed and answered as part of a blob."""
    database = str(folder / "bare.db")
    Path(database).unlink(missing_ok=True)
    with client("keep", folder, endpoint="tcp/127.0.0.1:0", database=database) as keeper:
        with client("ask", folder, endpoint=ready_at(keeper), events=events) as sender:
            sender_result = result(sender)
        kept_count = result(keeper)["requests"]
    if kept_count != sender_result["requests"]:
        raise Lost(f"{sender_result['requests']} requests were sent and {kept_count} stored")
    return float(1e6 * sender_result["seconds"] / sender_result["events"])


def stored(
    folder: Path, checkout: Path, count: int, deliver: Callable[[str], float], peaks: list[float]
) -> float:
    """Return the microseconds an event until a daemon has stored it; note its peak of memory.

    deliver: delivers all to an endpoint, and returns the seconds that this takes.
    """
    shutil.rmtree(folder / "state", ignore_errors=True)
    with running(folder, checkout=checkout) as (endpoint, pid):
        with peak_memory(pid) as peak:
            seconds = deliver(endpoint)
        status = status_of(endpoint)
    if status.events.stored != count or status.events.lost:
        raise Lost(f"{count} events were delivered, and of these {status}")
    peaks.append(peak[0] / 1e6)
    print(f"    {1e6 * seconds / count:.1f} us, {peak[0] / 1e6:.0f} MB", flush=True)
    return 1e6 * seconds / count


def spools(folder: Path, checkout: Path, endpoint: str) -> float:
    """Deliver as the spools of all cameras would; return the seconds until all is stored."""
    with client("deliver", folder, endpoint=endpoint, events=str(folder / "events")) as sender:
        return float(result(sender)["seconds"])


def ingest(folder: Path, checkout: Path, endpoint: str) -> float:
    """Run `camtopod ingest` of a checkout; return its seconds."""
    shutil.rmtree(folder / "spools", ignore_errors=True)
    command = [*PROGRAM, "--connect", endpoint, "ingest", "jsonl", str(folder / "events.jsonl")]
    start = time.monotonic()
    subprocess.run(
        [sys.executable, *command, "--state", str(folder / "spools")],
        check=True,
        stderr=subprocess.DEVNULL,
        **in_checkout(checkout),
    )
    return time.monotonic() - start
