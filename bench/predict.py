"""Measure `camtopod predict` on a long recording, beside that of another checkout.

    python -m bench predict --base FOLDER [--cameras 12] [--events 1000000] [--rounds 1]
        [--answers predictions,walks] [--inputs file,pipe] [--json FILE]

The recording is that of a simulated site, of which each checkout has learned the first tenth. In
each round both answer it, in turns, as a file and as a pipe that is filled as fast as it is read.
Measured are the processor time of the process, its peak memory (VmHWM, fifty times a second), and
the seconds from its start to the first line of output. FOLDER is another checkout, made by
``git worktree add FOLDER COMMIT``.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import bench
from bench.support import ratios
from bench.support.parts import part_parser
from bench.support.site import LEARNED_PER_SECOND_PER_CAMERA, LOOK_SECONDS, resident, traffic
from camtopod.codec import to_json

COST_MAX = 0.2
"""Target: share of the processor time, and of the memory, of the base."""
MEASURES = (
    ("processor", "s", COST_MAX),
    ("peak memory", "MB", COST_MAX),
    ("first line", "s", None),
)
"""What is measured, its unit, and the target: largest ratio to the base.

The first line of a pipe is to come within a second.
"""
LEARNED_SHARE = 0.1
"""Share of the events that is learned."""
OPTIONS: dict[str, list[str]] = {"predictions": [], "walks": ["--walks"]}
"""Options of the command, by answers."""
INPUTS = ("file", "pipe")
HERE, BASE = "this checkout", "base"


class RunCost(NamedTuple):
    """Figures of one run: processor seconds, peak of 10^6 bytes, seconds to the first line."""

    processor: float
    memory: float
    first: float


def main(argv: Sequence[str]) -> int:
    """Measure, print the tables, write the figures; return the exit status."""
    arguments = _parse(argv)
    checkouts = {BASE: arguments.base.resolve(), HERE: Path(bench.__path__[0]).parent}
    tables = []
    with tempfile.TemporaryDirectory() as name:
        events, beginning = prepare(Path(name), arguments.cameras, arguments.events)
        topologies = {
            side: learn(checkout, beginning, Path(name, f"{side}.json"))
            for side, checkout in checkouts.items()
        }
        for answers in arguments.answers.split(","):
            for source in arguments.inputs.split(","):
                runs: dict[str, list[RunCost]] = {side: [] for side in checkouts}
                for number in range(arguments.rounds):
                    for side in (BASE, HERE) if number % 2 == 0 else (HERE, BASE):
                        options = [*OPTIONS[answers], topologies[side]]
                        runs[side].append(measure(checkouts[side], options, events, source))
                input_tables = tables_of(f"{answers} of a {source}", runs)
                print(
                    "\n".join(line for table in input_tables for line in ratios.lines(table)),
                    flush=True,
                )
                tables += input_tables
    ratios.write(
        arguments.json, "predict", tables, cameras=arguments.cameras, events=arguments.events
    )
    return 0


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = part_parser(__name__, __doc__)
    parser.add_argument("--base", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--cameras", type=int, default=12)
    parser.add_argument("--events", type=int, default=1_000_000)
    parser.add_argument("--answers", default=",".join(OPTIONS))
    parser.add_argument("--inputs", default=",".join(INPUTS))
    ratios.add_arguments(parser, rounds=1)
    return parser.parse_args(argv)


def prepare(folder: Path, cameras: int, count: int) -> tuple[Path, Path]:
    """Write a recording, and its beginning, to a folder; return both paths."""
    events, beginning = folder / "events.jsonl", folder / "beginning.jsonl"
    lines = [
        to_json(event) + b"\n"
        for event in traffic(cameras, LEARNED_PER_SECOND_PER_CAMERA * cameras, count)
    ]
    events.write_bytes(b"".join(lines))
    beginning.write_bytes(b"".join(lines[: max(int(LEARNED_SHARE * count), 1)]))
    return events, beginning


def learn(checkout: Path, events: Path, topology: Path) -> str:
    """Have a checkout learn a recording; return the path of its topology."""
    subprocess.run(
        _command("learn", str(events), "--topology", str(topology)),
        cwd=checkout,
        env=_environment(checkout),
        stderr=subprocess.DEVNULL,
        check=True,
    )
    return str(topology)


def measure(checkout: Path, arguments: list[str], events: Path, source: str) -> RunCost:
    """Return the figures of one run of `camtopod predict` of a checkout.

    source: one of `INPUTS`.
    """
    command = _command("predict", *arguments, "-" if source == "pipe" else str(events))
    with contextlib.ExitStack() as stack:
        feeding = None
        if source == "pipe":
            cat = subprocess.Popen(["cat", str(events)], stdout=subprocess.PIPE)
            feeding = stack.enter_context(cat).stdout
        start = time.monotonic()
        process = subprocess.Popen(
            command,
            cwd=checkout,
            env=_environment(checkout),
            stdin=feeding or subprocess.DEVNULL,
            stdout=subprocess.PIPE,
        )
        if feeding is not None:
            feeding.close()
        return _watch(process, start)


def _watch(process: subprocess.Popen[bytes], start: float) -> RunCost:
    """Return the figures of a process that began at a monotonic time, when it has ended."""
    assert process.stdout is not None
    first: list[float] = []
    peak = 0

    def read() -> None:
        assert process.stdout is not None
        while process.stdout.read1(1 << 20):  # type: ignore[attr-defined]
            first.append(time.monotonic() - start)
            del first[1:]

    # Look at its memory until it ends, but is not waited for.
    reading = threading.Thread(target=read)
    reading.start()
    wait_arguments = os.P_PID, process.pid, os.WEXITED | os.WNOWAIT | os.WNOHANG
    while os.waitid(*wait_arguments) is None:
        with contextlib.suppress(ValueError):  # it has just ended
            peak = max(peak, resident(process.pid, peak=True))
        time.sleep(LOOK_SECONDS)
    reading.join()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    process.stdout.close()
    if process.returncode != 0 or not first:
        raise RuntimeError(f"status {process.returncode} of {process.args!r}")
    return RunCost(usage.ru_utime + usage.ru_stime, peak / 1e6, first[0])


def tables_of(title: str, runs: dict[str, list[RunCost]]) -> list[ratios.Table]:
    """Return a table of processor time, one of memory, and one of the first line."""
    return [
        ratios.compare(
            f"{title}: {figure}",
            unit,
            {name: [cost[column] for cost in costs] for name, costs in runs.items()},
            BASE,
            {HERE: limit} if limit else None,
        )
        for column, (figure, unit, limit) in enumerate(MEASURES)
    ]


def _command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "camtopod", "--config", "none", *arguments]


def _environment(checkout: Path) -> dict[str, str]:
    """Return the environment in which a checkout's own package is imported."""
    return os.environ | {"PYTHONPATH": str(checkout)}
