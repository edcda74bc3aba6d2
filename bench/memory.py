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

import tempfile
from pathlib import Path
from typing import NamedTuple

from bench.support import ratios
from bench.support.clients import client, learned_status, result, write_events
from bench.support.figures import line_of
from bench.support.parts import part_parser
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


class MemoryUse(NamedTuple):
    """Memory in megabytes (10^6 bytes): peak, sum of peaks, at the end; events and versions."""

    peak: float
    sum_of_peaks: float
    size: float
    events: int
    versions: int


def main(argv: list[str]) -> int:
    """Measure, print the table and return the exit status."""
    parser = part_parser(__name__, __doc__)
    parser.add_argument("--cameras", default="100,1000,10000")
    parser.add_argument("--events", type=int, default=70_000)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    arguments = parser.parse_args(argv)
    rows = []
    columns = f"{'most MB':>10}{'each its most':>15}{'settled MB':>12}{'events':>9}{'versions':>10}"
    print(f"{'cameras':>8}{columns}{'to reach':>16}")
    for cameras in map(int, arguments.cameras.split(",")):
        use = measure(cameras, arguments.events)
        limit = MEGABYTES_MAX.get(cameras)
        target = "" if limit is None else f"<= {limit:.0f} {'yes' if use.peak <= limit else 'NO'}"
        sizes = f"{use.peak:10.0f}{use.sum_of_peaks:15.0f}{use.size:12.0f}"
        figures = f"{sizes}{use.events:9}{use.versions:10}"
        print(f"{cameras:8}{figures}{target:>16}", flush=True)
        print(line_of(f"{cameras} cameras", use.peak))
        share = use.peak / (limit or use.peak)
        once = Spread(use.peak, use.size, use.sum_of_peaks)
        rows.append(
            Row(
                f"{cameras} cameras",
                once,
                Spread(share, share, share),
                None if limit is None else 1.0,
            )
        )
    table = Table("resident memory of the daemon", "MB", "what is allowed", rows)
    ratios.write(arguments.json, "memory", [table])
    return 0


def measure(cameras: int, count: int) -> MemoryUse:
    """Return the memory of a daemon that learns ``count`` events."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        events = write_events(
            folder / "events", traffic(cameras, LEARNED_PER_SECOND_PER_CAMERA * cameras, count)
        )
        with (
            running(folder, limits=f"cameras_max = {cameras + 100}") as (endpoint, pid),
            peak_memory(pid) as peak,
        ):
            with client("deliver", folder, endpoint=endpoint, events=events) as sender:
                result(sender)
            status = learned_status(endpoint, LEARN_SECONDS_MAX)
            size, sum_of_peaks = resident(pid) / 1e6, resident(pid, peak=True) / 1e6
        return MemoryUse(peak[0] / 1e6, sum_of_peaks, size, status.events.stored, status.version)
