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


class Taken(NamedTuple):
    """Figures of one run: processor seconds, peak of 10^6 bytes, seconds to the first line."""

    processor: float
    memory: float
    first: float


def main(argv: Sequence[str]) -> int:
    """Measure, print the tables, write the figures; return the exit status."""
    given = _parse(argv)
    checkouts = {BASE: given.base.resolve(), HERE: Path(bench.__path__[0]).parent}
    tables = []
    with tempfile.TemporaryDirectory() as name:
        events, beginning = prepare(Path(name), given.cameras, given.events)
        topologies = {
            each: learn(checkout, beginning, Path(name, f"{each}.json"))
            for each, checkout in checkouts.items()
        }
        for answers in given.answers.split(","):
            for source in given.inputs.split(","):
                runs: dict[str, list[Taken]] = {each: [] for each in checkouts}
                for number in range(given.rounds):
                    for each in (BASE, HERE) if number % 2 == 0 else (HERE, BASE):
                        arguments = [*OPTIONS[answers], topologies[each]]
                        runs[each].append(measure(checkouts[each], arguments, events, source))
                made = tables_of(f"{answers} of a {source}", runs)
                print("\n".join(line for table in made for line in ratios.lines(table)), flush=True)
                tables += made
    if given.json:
        ratios.write(given.json, "predict", tables, cameras=given.cameras, events=given.events)
    return 0


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m bench predict", description="Measure camtopod predict."
    )
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


def measure(checkout: Path, arguments: list[str], events: Path, source: str) -> Taken:
    """Return the figures of one run of `camtopod predict` of a checkout.

    source: one of `INPUTS`.
    """
    command = _command("predict", *arguments, "-" if source == "pipe" else str(events))
    with contextlib.ExitStack() as stack:
        feeding = None
        if source == "pipe":
            cat = subprocess.Popen(["cat", str(events)], stdout=subprocess.PIPE)
            feeding = stack.enter_context(cat).stdout
        began = time.monotonic()
        process = subprocess.Popen(
            command,
            cwd=checkout,
            env=_environment(checkout),
            stdin=feeding or subprocess.DEVNULL,
            stdout=subprocess.PIPE,
        )
        if feeding is not None:
            feeding.close()
        return _watch(process, began)


def _watch(process: subprocess.Popen[bytes], began: float) -> Taken:
    """Return the figures of a process that began at a monotonic time, when it has ended."""
    assert process.stdout is not None
    first: list[float] = []
    most = 0

    def read() -> None:
        assert process.stdout is not None
        while process.stdout.read1(1 << 20):  # type: ignore[attr-defined]
            first.append(time.monotonic() - began)
            del first[1:]

    # Look at its memory until it ends, but is not waited for.
    reading = threading.Thread(target=read)
    reading.start()
    ended = os.P_PID, process.pid, os.WEXITED | os.WNOWAIT | os.WNOHANG
    while os.waitid(*ended) is None:
        with contextlib.suppress(ValueError):  # it has just ended
            most = max(most, resident(process.pid, most=True))
        time.sleep(LOOK_SECONDS)
    reading.join()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    process.stdout.close()
    if process.returncode != 0 or not first:
        raise RuntimeError(f"status {process.returncode} of {process.args!r}")
    return Taken(used.ru_utime + used.ru_stime, most / 1e6, first[0])


def tables_of(title: str, runs: dict[str, list[Taken]]) -> list[ratios.Table]:
    """Return a table of processor time, one of memory, and one of the first line."""
    return [
        ratios.compare(
            f"{title}: {what}",
            unit,
            {name: [taken[column] for taken in each] for name, each in runs.items()},
            BASE,
            {HERE: most} if most else None,
        )
        for column, (what, unit, most) in enumerate(MEASURES)
    ]


def _command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "camtopod", "--config", "none", *arguments]


def _environment(checkout: Path) -> dict[str, str]:
    """Return the environment in which a checkout's own package is imported."""
    return os.environ | {"PYTHONPATH": str(checkout)}
