"""Measure contestants in turns in one run, and compare the cost of each with a baseline's.

On a shared machine absolute times mean little: every round measures each contestant once, in an
order that rotates, and ratios are taken within a round. Reported are medians and quartiles over the
rounds.
"""

from __future__ import annotations

import argparse
import os
import platform
import resource
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median, quantiles
from typing import Any

from msgspec import Struct, to_builtins

from bench.support.figures import line_of
from bench.support.parts import write_json

WARM_ROUNDS = 1
"""Rounds that are measured first and dropped: they fill file caches and load libraries."""


class Spread(Struct):
    """Median and quartiles; with fewer than three values the quartiles are minimum and maximum."""

    median: float
    low: float
    high: float


class Row(Struct):
    """One contestant: ``cost`` in the table's unit, ``ratio`` to the baseline's by round."""

    name: str
    cost: Spread
    ratio: Spread
    at_most: float | None = None
    """Target: largest ratio."""

    @property
    def reached(self) -> bool | None:
        """True if the median ratio is within ``at_most``; None without it."""
        return None if self.at_most is None else self.ratio.median <= self.at_most


class Table(Struct):
    """Result of one comparison."""

    title: str
    unit: str
    baseline: str
    rows: list[Row]


def cpu_seconds() -> float:
    """Return the CPU seconds of this process, its threads, and children that were waited for."""
    usages = [
        resource.getrusage(process) for process in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    ]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def cpu_seconds_of(run: Callable[[], object]) -> float:
    """Return the CPU seconds that ``run`` takes."""
    start = cpu_seconds()
    run()
    return cpu_seconds() - start


def take_turns(
    contestants: Mapping[str, Callable[[], float]], rounds: int
) -> dict[str, list[float]]:
    """Return the cost that each contestant reports in each of ``rounds``, after the warm-up."""
    names = list(contestants)
    costs: dict[str, list[float]] = {name: [] for name in names}
    for number in range(WARM_ROUNDS + rounds):
        first = number % len(names)
        for name in names[first:] + names[:first]:
            cost = contestants[name]()
            if number >= WARM_ROUNDS:
                costs[name].append(cost)
    return costs


def spread(values: Sequence[float]) -> Spread:
    """Return the spread of at least one value."""
    if len(values) < 3:
        return Spread(median(values), min(values), max(values))
    low, _, high = quantiles(values, n=4, method="inclusive")
    return Spread(median(values), low, high)


def compare(
    title: str,
    unit: str,
    costs: Mapping[str, Sequence[float]],
    baseline: str,
    at_most: Mapping[str, float] | None = None,
) -> Table:
    """Compare costs, as returned by `take_turns`, with those of ``baseline``.

    ``at_most``: targets of the ratios, by contestant.
    """
    rows = []
    for name, values in costs.items():
        ratios = [cost / base for cost, base in zip(values, costs[baseline], strict=True)]
        rows.append(Row(name, spread(values), spread(ratios), (at_most or {}).get(name)))
    return Table(title, unit, baseline, rows)


def lines(table: Table) -> list[str]:
    """Return the lines of a table: medians with quartiles in brackets."""
    cost, ratio = f"{table.unit} (quartiles)", f"/ {table.baseline}"
    result = [f"{table.title:52}{cost:>30}{ratio:>30}{'to reach':>14}"]
    for row in table.rows:
        target = ""
        if row.at_most is not None:
            target = f"<= {row.at_most:.2f} {'yes' if row.reached else 'NO'}"
        result.append(
            f"  {row.name:50}{_cell(row.cost, 3):>30}{_cell(row.ratio, 2):>30}{target:>14}"
        )
    for row in table.rows:
        title = f"{table.title}, {row.name}"
        result.append(line_of(title, row.cost.median))
        if row.name != table.baseline:
            result.append(line_of(f"{title} / {table.baseline}", row.ratio.median))
    return result


def _cell(values: Spread, digits: int) -> str:
    return f"{values.median:.{digits}f} ({values.low:.{digits}f} .. {values.high:.{digits}f})"


def add_arguments(parser: argparse.ArgumentParser, rounds: int) -> None:
    """Add ``--rounds`` and ``--json``."""
    parser.add_argument(
        "--rounds", type=int, default=rounds, help=f"measured rounds (default {rounds})"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")


def write(path: Path | None, part: str, tables: Sequence[Table], **facts: Any) -> None:
    """Write figures and machine as JSON, if a file is named."""
    machine = {
        "cores": os.cpu_count(),
        "processor": platform.machine(),
        "python": platform.python_version(),
    }
    content = {"part": part, "machine": machine, **facts, "tables": to_builtins(list(tables))}
    write_json(path, content)
