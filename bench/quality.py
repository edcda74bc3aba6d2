"""Measure zones, links and predictions of camtopod and of the baselines on many networks.

    python -m bench quality [--seeds N] [--first-seed S] [--regimes a,b] [--methods a,b] [--jobs 2]
                            [--scale X] [--json FILE] [--no-baselines]

camtopod runs in three modes. ``online`` receives event by event, as `camtopod learn --updates`
does; a version at 70 % of the events predicts the rest, and another is made at the end. In ``live``
the newest version that has fallen due predicts each exit of the rest, as in the daemon. ``batch``
is the one fit of `camtopod learn`. Each network is simulated from its seed (`support.regimes`). The
learner was developed with seeds 0 to 9; networks from ``--first-seed 1000`` on are unused in
development. ``auditorium`` is the real recording that comes with the package. Figures are means
over networks with their standard errors.

With ``--json`` each result is appended to a file as soon as it is there, and results that the file
has are not measured again. Results of an older learner have to be deleted by hand.

The baselines are given the true zones and no clutter. Without true zones, each camera is a zone and
links are pairs of cameras. In each regime they have the variant and threshold with the best mean F1
on these very networks; their second F1 is at the one variant and threshold that are best over all
regimes, the condition under which camtopod works. The oracle (a Markov chain that is given the
identities) has the pseudo-count that is best on each network.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

from bench.support.jobs import completed_tasks
from bench.support.measure import GROUPS, Record, measure
from bench.support.parts import names_from, part_parser
from bench.support.regimes import REGIMES
from bench.support.table import figure_lines, tables
from camtopod.codec import read, to_json
from camtopod.learn.settings import Settings
from camtopod.records import Event, Pair
from camtopod.sim import AUDITORIUM
from camtopod.sim.truth import CLUTTER, TRUTH_SCHEMA, Truth

REAL = "auditorium"
"""Name of the real recording."""
AUDITORIUM_PAIRS = (
    Pair(("HC3", "HC4"), "overlapped"),
    Pair(("HC3", "IP5"), "unseen_path"),
    Pair(("IP2", "IP5"), "overlapped"),
)
"""Related camera pairs of the recording, from its description."""


class Task(NamedTuple):
    """One group of methods on one network."""

    regime: str
    seed: int
    group: str
    scale: float


class Result(msgspec.Struct):
    """A line of the JSON file: a task and its records."""

    regime: str
    seed: int
    group: str
    scale: float
    records: list[Record]

    @property
    def task(self) -> Task:
        """The task of these records."""
        return Task(self.regime, self.seed, self.group, self.scale)


def main(argv: list[str]) -> int:
    """Measure all missing results, print the table and return the exit status."""
    arguments = _parse(argv)
    results = _results(_tasks(arguments), arguments.jobs, arguments.json)
    records = [record for result in results for record in result.records]
    lines = tables(records, arguments.regimes) + figure_lines(records, arguments.regimes)
    print("\n".join(lines))
    return 0


def _tasks(arguments: argparse.Namespace) -> list[Task]:
    """Return all tasks, seed by seed, so that an interrupted run has results of every regime."""
    groups = [group for group in GROUPS if group in arguments.methods.split(",")]
    if arguments.no_baselines:
        groups = [group for group in groups if group != "baselines"]
    tasks = []
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
        for regime in arguments.regimes:
            if regime != REAL:
                tasks += [Task(regime, seed, group, arguments.scale) for group in groups]
    if REAL in arguments.regimes:
        tasks += [Task(REAL, 0, group, 1.0) for group in groups]
    return tasks


def _results(tasks: Sequence[Task], jobs: int, path: Path | None) -> list[Result]:
    """Return the results of the tasks.

    Those of earlier runs are read from ``path``; new ones are appended to it as they come.
    """
    results = {result.task: result for result in _read(path)}
    new_tasks = [task for task in tasks if task not in results]
    start = time.perf_counter()
    for number, result in enumerate(completed_tasks(run, new_tasks, jobs), 1):
        results[result.task] = result
        if path is not None:
            with path.open("ab") as out:
                out.write(to_json(result) + b"\n")
        print(
            f"{time.perf_counter() - start:7.0f} s, {number} of {len(new_tasks)}: "
            f"{result.regime} {result.seed} {result.group}",
            file=sys.stderr,
        )
    return [results[task] for task in tasks]


def _parse(argv: list[str]) -> argparse.Namespace:
    parser = part_parser(__name__, __doc__)
    parser.add_argument("--seeds", type=int, default=10, help="networks per regime (default 10)")
    parser.add_argument(
        "--first-seed", type=int, default=0, help="1000: networks unused in development (default 0)"
    )
    parser.add_argument(
        "--scale", type=float, default=1.0, help="length of the recordings (default 1.0)"
    )
    parser.add_argument(
        "--regimes",
        type=names_from([*REGIMES, REAL]),
        default=[*REGIMES, REAL],
        help="comma-separated (default: all)",
    )
    parser.add_argument(
        "--methods", default=",".join(GROUPS), help=f"of {','.join(GROUPS)} (default: all)"
    )
    parser.add_argument("--no-baselines", action="store_true")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    parser.add_argument(
        "--json",
        type=Path,
        metavar="FILE",
        help="append results to this file, and reuse those in it",
    )
    return parser.parse_args(argv)


def _read(path: Path | None) -> list[Result]:
    """Return the results of earlier runs, without a last line that was cut short by a kill."""
    if path is None or not path.exists():
        return []
    whole = path.read_bytes().rpartition(b"\n")[0] + b"\n"
    if len(whole) < path.stat().st_size:
        path.write_bytes(whole)
    return [msgspec.json.decode(line, type=Result) for line in whole.splitlines() if line]


def run(task: Task) -> Result:
    """Simulate (or read) the network of a task and measure it."""
    if task.regime == REAL:
        events, truth = recorded(AUDITORIUM)
        settings = Settings()
    else:
        regime = REGIMES[task.regime]
        events, truth = regime.make(task.seed, task.scale)
        settings = regime.learning(task.scale)
    return Result(*task, measure(task.group, task.regime, task.seed, events, truth, settings))


def recorded(folder: Path) -> tuple[list[Event], Truth]:
    """Return the events and the ground truth of the recording, which lacks zones and links."""
    events = [read(Event, line) for line in (folder / "events.jsonl").read_bytes().splitlines()]
    events.sort(key=lambda event: event.t)
    with (folder / "identities.csv").open(newline="") as lines:
        identity = {row["track"]: int(row["identity"]) for row in csv.DictReader(lines)}
    persons = [identity.get(str(event.track), CLUTTER) for event in events]

    # Number the passages of each person.
    passages: dict[int, list[str]] = {}
    number = []
    for event, person in zip(events, persons, strict=True):
        tracks = passages.setdefault(person, [])
        if str(event.track) not in tracks:
            tracks.append(str(event.track))
        number.append(CLUTTER if person == CLUTTER else tracks.index(str(event.track)))
    truth = Truth(
        schema=TRUTH_SCHEMA,
        cameras=sorted({event.camera for event in events}),
        zones=[],
        links=[],
        pairs=list(AUDITORIUM_PAIRS),
        identity=persons,
        passage=number,
        zone=[CLUTTER] * len(events),
    )
    return events, truth
