"""Measure the memory of the daemon at 100, 1,000 and 10,000 cameras.

    python -m bench memory [--cameras 100,1000,10000] [--events 70000] [--json FILE]

The real `camtopod run` starts without state and receives the traffic of a simulated network, 0.1
events a second and camera, as fast as it takes it. Its window holds all of them (2,000 events a
camera, at least 60,000). Settings are the default ones but for the number of cameras. Measured are

* the peak of daemon and child process together, sampled fifty times a second; pages of files that
  both have mapped count once
* the sum of each one's own peak (VmHWM), which is more, as one works while the other waits
* the memory when all is learned
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import NamedTuple

from bench.support import ratios
from bench.support.clients import client, learned_status, result, write_events
from bench.support.figures import line_of
from bench.support.ratios import Row, Spread, Table
from bench.support.site import (
    LEARNED_PER_SECOND_PER_CAMERA,
    peak_memory,
    resident,
    running,
    traffic,
)

MEGABYTES_MAX = {100: 400.0, 1_000: 1_000.0, 10_000: 4_000.0}
"""Targets of the peak by number of cameras, megabytes."""
LEARN_SECONDS_MAX = 3_600.0
"""Longest wait for the learner, seconds."""


class Taken(NamedTuple):
    """Memory in megabytes (10^6 bytes): peak, sum of peaks, at the end; events and versions."""

    most: float
    added: float
    settled: float
    events: int
    versions: int


def main(argv: list[str]) -> int:
    """Measure, print the table and return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m bench memory", description="Measure the daemon's memory."
    )
    parser.add_argument("--cameras", default="100,1000,10000")
    parser.add_argument("--events", type=int, default=70_000)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    given = parser.parse_args(argv)
    rows = []
    columns = f"{'most MB':>10}{'each its most':>15}{'settled MB':>12}{'events':>9}{'versions':>10}"
    print(f"{'cameras':>8}{columns}{'to reach':>16}")
    for cameras in map(int, given.cameras.split(",")):
        taken = measure(cameras, given.events)
        allowed = MEGABYTES_MAX.get(cameras)
        wanted = (
            ""
            if allowed is None
            else f"<= {allowed:.0f} {'yes' if taken.most <= allowed else 'NO'}"
        )
        sizes = f"{taken.most:10.0f}{taken.added:15.0f}{taken.settled:12.0f}"
        figures = f"{sizes}{taken.events:9}{taken.versions:10}"
        print(f"{cameras:8}{figures}{wanted:>16}", flush=True)
        print(line_of(f"{cameras} cameras", taken.most))
        share = taken.most / (allowed or taken.most)
        once = Spread(taken.most, taken.settled, taken.added)
        rows.append(
            Row(
                f"{cameras} cameras",
                once,
                Spread(share, share, share),
                None if allowed is None else 1.0,
            )
        )
    if given.json:
        ratios.write(
            given.json,
            "memory",
            [Table("resident memory of the daemon", "MB", "what is allowed", rows)],
        )
    return 0


def measure(cameras: int, count: int) -> Taken:
    """Return the memory of a daemon that learns ``count`` events."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        events = write_events(
            folder / "events", traffic(cameras, LEARNED_PER_SECOND_PER_CAMERA * cameras, count)
        )
        with (
            running(folder, limits=f"cameras_max = {cameras + 100}") as (endpoint, pid),
            peak_memory(pid) as most,
        ):
            with client("deliver", folder, endpoint=endpoint, events=events) as sender:
                result(sender)
            status = learned_status(endpoint, LEARN_SECONDS_MAX)
            settled, added = resident(pid) / 1e6, resident(pid, most=True) / 1e6
        return Taken(most[0] / 1e6, added, settled, status.events.stored, status.version)
