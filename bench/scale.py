"""Measure the cost of an event in `camtopod learn` on sites of growing size.

    python -m bench scale [--cameras 100,1000,10000] [--hours 0.5] [--rate 0.1] [--rounds 1]
                          [--json FILE]

Each site is simulated with the same traffic per camera (``--rate`` events a second and camera), its
events are written to a file, and `camtopod learn` runs over it as a process of its own: processor
time per event, peak memory, and accuracy of the links. The ratio is to the next smaller site;
target: 1.3 a step.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from msgspec import Struct, to_builtins

from bench.support import ratios
from bench.support.ratios import Row, Table, spread
from camtopod.cli.commands.export import load
from camtopod.codec import to_json
from camtopod.sim.scoring import Score, score
from camtopod.sim.simulation import SimSettings, simulate

STEP_MAX = 1.3
"""Target: largest ratio of an event's cost to that on the next smaller site."""
MEMORY_MAX_MB = {100: 300.0, 1_000: 1_000.0, 10_000: 4_000.0}
"""Targets of the peak memory by number of cameras, megabytes."""
EVENTS_PER_OBJECT = 8.1
"""Events of an object that enters a simulated site, about."""

COLUMNS = "{:>8}{:>10}{:>10}{:>26}{:>8}{:>8}{:>11}{:>8}"
HEADER = COLUMNS.format(
    "cameras", "events", "a second", "us an event", "step", "MB", "precision", "recall"
)


class Size(Struct):
    """Figures of one size of site."""

    cameras: int
    events: int
    rate: float
    """Events a second and camera."""
    each_microseconds: list[float]
    """Processor time per event in each round, microseconds."""
    memory_mb: float
    precision: float
    recall: float
    """Precision and recall are of the links between views."""


def main(argv: Sequence[str]) -> int:
    """Measure, print the table, write the figures; return the exit status."""
    arguments = _parse(argv)
    sizes: list[Size] = []
    print(HEADER)
    with tempfile.TemporaryDirectory() as folder:
        for cameras in map(int, arguments.cameras.split(",")):
            sizes.append(
                measure(Path(folder), cameras, arguments.hours, arguments.rate, arguments.rounds)
            )
            print(line(sizes), flush=True)
    if arguments.json is not None:
        ratios.write(arguments.json, "scale", tables(sizes), sizes=to_builtins(sizes))
    return 0


def tables(sizes: Sequence[Size]) -> list[Table]:
    """Compare each size with the one before, and its memory with the target."""
    steps = [
        ratios.compare(
            f"cost of an event, {before.cameras} to {now.cameras} cameras",
            "us",
            {name(size): size.each_microseconds for size in (before, now)},
            name(before),
            at_most={name(now): STEP_MAX},
        )
        for before, now in pairwise(sizes)
    ]
    memory = []
    for size in sizes:
        allowed = MEMORY_MAX_MB.get(size.cameras)
        share = size.memory_mb / (allowed or size.memory_mb)
        memory.append(
            Row(
                name(size),
                spread([size.memory_mb]),
                spread([share]),
                None if allowed is None else 1.0,
            )
        )
    return [*steps, Table("most memory of camtopod learn", "MB", "what is allowed", memory)]


def name(size: Size) -> str:
    """Return the title of a row."""
    return f"{size.cameras} cameras"


def measure(folder: Path, cameras: int, hours: float, rate: float, rounds: int) -> Size:
    """Simulate one site and learn it ``rounds`` times."""
    objects = rate * cameras / EVENTS_PER_OBJECT
    events, truth = simulate(
        SimSettings(cameras=cameras, hours=hours, seed=cameras, objects_per_second=objects)
    )
    recorded, learned = folder / "events.jsonl", folder / "topology.json"
    with recorded.open("wb") as out:
        out.writelines(to_json(event) + b"\n" for event in events)
    runs = [learn(recorded, learned) for _ in range(rounds)]
    found: Score = score(load(str(learned)), truth)
    return Size(
        cameras,
        len(events),
        len(events) / (3600.0 * hours * cameras),
        [seconds / len(events) * 1e6 for seconds, _ in runs],
        max(memory for _, memory in runs),
        found.link_precision,
        found.link_recall,
    )


def learn(recorded: Path, learned: Path) -> tuple[float, float]:
    """Return processor seconds and peak megabytes of one `camtopod learn`."""
    command = [sys.executable, "-m", "camtopod", "learn", str(recorded), "--topology", str(learned)]
    process = subprocess.Popen(
        command, stderr=subprocess.DEVNULL, env={**os.environ, "OMP_NUM_THREADS": "1"}
    )
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise RuntimeError(f"camtopod learn failed with status {os.waitstatus_to_exitcode(status)}")
    process.returncode = 0
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0


def line(sizes: Sequence[Size]) -> str:
    """Return the table's line of the newest size, with its ratio to the one before."""
    now, cost = sizes[-1], spread(sizes[-1].each_microseconds)
    step = (
        "" if len(sizes) < 2 else f"{cost.median / spread(sizes[-2].each_microseconds).median:.2f}"
    )
    wanted = MEMORY_MAX_MB.get(now.cameras)
    too_much = "" if wanted is None or now.memory_mb <= wanted else f" (more than {wanted:.0f} MB)"
    dear = "" if not step or float(step) <= STEP_MAX else f" (more than {STEP_MAX})"
    row = COLUMNS.format(
        now.cameras,
        now.events,
        f"{now.rate:.3f}",
        f"{cost.median:.0f} ({cost.low:.0f} .. {cost.high:.0f})",
        step,
        f"{now.memory_mb:.0f}",
        f"{now.precision:.3f}",
        f"{now.recall:.3f}",
    )
    return row + dear + too_much


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m bench scale", description="Measure the cost of an event on larger sites."
    )
    parser.add_argument(
        "--cameras", default="100,1000,10000", help="sizes of site, comma-separated"
    )
    parser.add_argument(
        "--hours", type=float, default=0.5, help="length of the recordings (default 0.5)"
    )
    parser.add_argument(
        "--rate", type=float, default=0.1, help="events a second and camera (default 0.1)"
    )
    ratios.add_arguments(parser, rounds=1)
    return parser.parse_args(argv)
