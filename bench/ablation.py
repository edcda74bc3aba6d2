"""Measure what each mechanism of the learner is worth: all figures with it and without it.

    python -m bench ablation [--data FOLDER] [--constants] [--mechanisms a,b] [--regimes a,b]
                             [--controls a,b] [--seeds N] [--scale X] [--labels car:.80,van:.12]
                             [--jobs 2] [--json FILE]
    python -m bench ablation --clips FOLDER [--phases 1] [--mechanisms a,b] [--jobs 2]

Networks are the real ones of `bench real` (none without data), the simulated ones of
`support.regimes`, and those of `bench controls`, whose true links are all known. The first 70 % of
a real or simulated network is learned in one fit, and the rest is scored.

A cost is the figure without the mechanism less the figure with all mechanisms, on the same network.
Costs are positive where the figure is worse: log loss, calibration error and false links that are
higher, links and top-1 that are lower. A mechanism earns its place if its cost is more than two
standard errors on the real networks, or more than two standard errors and more than `REGIME_COST`
on one kind of simulated network.

The figures at the end are what each mechanism is worth: its costs on the real networks as means
over their kinds, with the standard error over kinds, as bench/README shows them. With ``--clips``
they are those of the mechanisms of vision on the clips of `bench grab_truth`: F1 by kind of view,
and false events where nothing happens.

With ``--constants`` each constant is halved and doubled instead. The last table cross-validates
them: each kind of real network is measured with the value that is best on the other kinds. With
``--labels`` the identities of the real networks draw labels, as in `bench real`.
"""

from __future__ import annotations

import argparse
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct

from bench import controls, grab_truth, real
from bench.support.figures import line_of
from bench.support.jobs import map_tasks
from bench.support.measure import measure as measure_regime
from bench.support.mechanisms import CONSTANTS, FACTORS, MECHANISMS, SCALED, VISION, times, without
from bench.support.parts import data_parser, folders_in, names_from, write_json
from bench.support.real_options import Options, label_shares
from bench.support.regimes import REGIMES
from bench.support.truth_clips import clips_in

REAL = "real"
"""Kind of the real networks."""
CONTROLS = "controls, "
"""What the kinds of `bench controls` are called after."""
KINDS = {
    "burrow": "closed",
    "cages": "closed",
    "concourse": "hall",
    "forum": "hall",
    "junction": "street",
}
"""Kind of a real network by the first part of its name, where that is not its kind."""
DEFAULT_REGIMES = "hall,crowd,walkway,road,short,dense,faulty"
REGIME_COST = 0.01
"""Least cost that counts on simulated networks, in the figure's unit."""
EVIDENCE_NATS = 6.0
"""Least evidence of a link that the events can tell, nats."""
FIGURES = ("log loss", "leave", "calibration", "top-1", "links", "false")
"""Figures of the table.

Log loss, and its part about leaving the site, are above those of an oracle (a chain that is given
the identities); calibration error is of the first guess; top-1 is relative to the oracle's; links
are the found ones of those the events can tell (real networks), F1 of links or camera pairs
(simulated ones), or the number of right ways (controls); false is the number of false links.
"""
WORSE = (1.0, 1.0, 1.0, -1.0, -1.0, 1.0)
"""Sign of a difference that is worse, by figure."""
WORTH = ("log loss", "links", "false")
"""Figures that bench/README shows of each mechanism."""


class Task(Struct, frozen=True):
    """One network, learned without one mechanism ("": with all)."""

    mechanism: str
    kind: str
    network: str
    scale: float
    labels: dict[str, float] = {}


def main(argv: Sequence[str]) -> int:
    """Measure, print the tables and return the exit status."""
    arguments = _parse(argv)
    if arguments.clips is not None:
        print("\n".join(_worth_on_clips(arguments)))
        return 0
    mechanisms, verdict = MECHANISMS, "earns its place"
    if arguments.constants:
        mechanisms, verdict = SCALED, "worse than as it is"
    names = arguments.mechanisms or [mechanism.name for mechanism in mechanisms]

    # Networks.
    networks = [(REAL, str(folder)) for folder in folders_in(arguments.data)]
    if not networks:
        print("bench ablation: no real networks are measured (set --data or CAMTOPOD_REAL_DATA)")
    for kind in arguments.regimes:
        networks += [(kind, str(seed)) for seed in range(arguments.seeds)]
    for kind in arguments.controls:
        for title in controls.controls()[kind]:
            networks += [(CONTROLS + kind, f"{title}|{seed}") for seed in range(arguments.seeds)]

    # Measure.
    tasks = [
        Task(name, kind, network, arguments.scale, arguments.labels)
        for kind, network in networks
        for name in ("", *names)
    ]
    rows = map_tasks(measure, tasks, arguments.jobs)
    figures = {
        (task.mechanism, task.kind, task.network): np.array(row)
        for task, row in zip(tasks, rows, strict=True)
    }

    # Report.
    print("\n".join(table(figures, names, verdict)))
    if arguments.constants:
        print("\n".join(chosen_on_the_others(figures)))
    print("\n".join(worth(figures, names)))
    write_json(arguments.json, [[*key, *row.tolist()] for key, row in figures.items()])
    return 0


def measure(task: Task) -> list[float]:
    """Return the `FIGURES` of one network without one mechanism; nan where one does not apply."""
    with without(task.mechanism):
        if task.kind == REAL:
            return _real(Path(task.network), task.labels)
        if task.kind.startswith(CONTROLS):
            title, _, seed = task.network.rpartition("|")
            kind = task.kind.removeprefix(CONTROLS)
            outcome = controls.run(controls.Task(kind, title, int(seed)))
            return [*[math.nan] * 4, float(outcome.right), float(len(outcome.false))]
        regime = REGIMES[task.kind]
        events, truth = regime.make(int(task.network), task.scale)
        [record] = measure_regime(
            "batch", task.kind, int(task.network), events, truth, regime.learning(task.scale)
        )
    links = record.get("f1")
    if math.isnan(links):
        links = record.get("pair_f1")
    figures = [record.get(name) for name in ("first_calibration_error", "top1_ratio")]
    return [record.get("log_loss_above"), math.nan, *figures, links, record.get("false_links")]


def _real(folder: Path, labels: dict[str, float]) -> list[float]:
    """Return the `FIGURES` of a real network, whose identities draw labels."""
    result = real.measure(folder, Options(labels=labels), beside=False)
    links = math.nan
    if result.links.can_be_told[EVIDENCE_NATS]:
        links = result.links.found[EVIDENCE_NATS] / result.links.can_be_told[EVIDENCE_NATS]
    figures = [math.nan] * 4
    ours, oracle = result.ours, result.told
    if ours is not None and oracle is not None:
        figures = [
            ours.log_loss - oracle.log_loss,
            ours.leave_loss - oracle.leave_loss,
            ours.calibration_error,
            ours.top1 / oracle.top1,
        ]
    return [*figures, links, float(result.links.false)]


def table(
    figures: dict[tuple[str, str, str], Any], names: Sequence[str], verdict: str = "earns its place"
) -> list[str]:
    """Return one block a kind of network with one row a mechanism, then the significant costs."""
    kinds = list(dict.fromkeys(kind for _, kind, _ in figures))
    lines, earns = [], defaultdict[str, list[str]](list)
    for kind in kinds:
        # Means with all mechanisms.
        networks = [key[2] for key in figures if key[:2] == ("", kind)]
        columns = zip(*(figures["", kind, network] for network in networks), strict=True)
        lines += ["", _row(f"{kind}, {len(networks)} networks", *FIGURES)]
        lines.append(_row("with all", *(f"{_mean(column):.3f}" for column in columns)))
        for name in names:
            # Paired differences without one mechanism, with standard errors.
            apart = np.array(
                [figures[name, kind, network] - figures["", kind, network] for network in networks]
            )
            cells = []
            for column, figure in enumerate(FIGURES):
                costs = apart[:, column][~np.isnan(apart[:, column])]
                if len(costs) == 0:
                    cells.append("-")
                    continue
                mean, error = float(costs.mean()), math.nan
                if len(costs) > 1:
                    error = float(costs.std(ddof=1) / math.sqrt(len(costs)))
                cells.append(f"{mean:+.3f} ({error:.3f})")
                cost = WORSE[column] * mean
                if cost > 2.0 * error and (kind == REAL or cost > REGIME_COST):
                    earns[name].append(f"{figure} of {kind} {mean:+.3f}")
            lines.append(_row(f"- {name}", *cells))
    return [
        *lines,
        "",
        f"{verdict}:",
        *(f"  {name}: {', '.join(earns[name]) or 'NOTHING'}" for name in names),
    ]


def worth(figures: dict[tuple[str, str, str], Any], names: Sequence[str]) -> list[str]:
    """Return one line a mechanism and figure of `WORTH`: its cost, mean over kinds of network."""
    networks = [key[2] for key in figures if key[:2] == ("", REAL)]
    lines = []
    for name in names:
        for figure in WORTH:
            column, by_kind = FIGURES.index(figure), defaultdict[str, list[float]](list)
            for network in networks:
                cost = figures[name, REAL, network][column] - figures["", REAL, network][column]
                by_kind[kind_of(network)].append(WORSE[column] * cost)
            lines += _line_of_costs(f"{name}, {figure}", by_kind)
    return lines


class ClipFigures(NamedTuple):
    """Figures of all clips, analysed without one mechanism."""

    f1: dict[str, list[float]]
    """F1 of each clip with events, by kind of view."""
    false: float
    """False events in the others."""


def measure_clips(mechanism: str, folder: Path, phases: int) -> ClipFigures:
    """Analyse the clips of a folder without one mechanism ("": with all)."""
    with without(mechanism):
        scores = [grab_truth.scored(clip, phases)[0] for clip in clips_in(folder)]
    return ClipFigures(grab_truth.f1_by_kind(scores), grab_truth.false_events(scores))


def _worth_on_clips(arguments: argparse.Namespace) -> list[str]:
    """Return two lines a mechanism of vision: its cost in F1, and in false events."""
    names = arguments.mechanisms or [mechanism.name for mechanism in VISION]
    measure_one = partial(measure_clips, folder=arguments.clips, phases=arguments.phases)
    with_all, *others = map_tasks(measure_one, ["", *names], arguments.jobs)
    lines = []
    for name, figures in zip(names, others, strict=True):
        costs = {
            kind: [before - after for before, after in zip(f1, figures.f1[kind], strict=True)]
            for kind, f1 in with_all.f1.items()
        }
        lines += _line_of_costs(f"{name}, F1", costs)
        lines.append(line_of(f"{name}, false events", figures.false - with_all.false))
    return lines


def _line_of_costs(title: str, by_kind: Mapping[str, Sequence[float]]) -> list[str]:
    """Return the line of a mean over kinds and its standard error; none without a figure."""
    costs = [mean for mean in map(_mean, by_kind.values()) if not math.isnan(mean)]
    error = math.nan
    if len(costs) > 1:
        error = float(np.std(costs, ddof=1) / math.sqrt(len(costs)))
    return [line_of(title, _mean(costs), error)] if costs else []


def chosen_on_the_others(figures: dict[tuple[str, str, str], Any]) -> list[str]:
    """Return one row a constant: the cost of choosing its value on the other kinds of networks.

    The cost is the mean log loss of each kind of real network with the value that is best for the
    other kinds, less that with the present value. Its standard error is that over kinds.
    """
    networks: dict[str, list[str]] = defaultdict(list)
    for name, kind, network in figures:
        if kind == REAL and name == "":
            networks[kind_of(network)].append(network)
    lines = ["", _row("real, one kind left out", "log loss")]
    for constant, _ in CONSTANTS:
        names = ["", *(times(constant, factor) for factor in FACTORS)]
        if len(networks) < 2 or not {*names} <= {name for name, *_ in figures}:
            continue
        loss = np.array(
            [
                [_mean([figures[name, REAL, n][0] for n in group]) for group in networks.values()]
                for name in names
            ]
        )
        loss_elsewhere = loss.sum(axis=1, keepdims=True) - loss
        apart = loss[loss_elsewhere.argmin(axis=0), np.arange(len(networks))] - loss[0]
        error = float(apart.std(ddof=1) / math.sqrt(len(networks)))
        lines.append(_row(constant, f"{apart.mean():+.3f} ({error:.3f})"))
    return lines


def kind_of(network: str) -> str:
    """Return the kind of a real network, by its folder: those of one kind are alike."""
    first = Path(network).name.partition("-")[0]
    return KINDS.get(first, first)


def _mean(values: Sequence[float]) -> float:
    """Return the mean of the values that are not nan."""
    numbers = [value for value in values if not math.isnan(value)]
    return sum(numbers) / len(numbers) if numbers else math.nan


def _row(title: str, *cells: object) -> str:
    return "  ".join([f"{title:28}", *(f"{cell!s:>16}" for cell in cells)])


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = data_parser(__name__, __doc__)
    parser.add_argument(
        "--constants", action="store_true", help="halve and double constants instead"
    )
    parser.add_argument("--clips", type=Path, metavar="FOLDER", help="measure vision, on clips")
    parser.add_argument("--phases", type=int, default=1, help="analyses of a clip (default 1)")
    parser.add_argument(
        "--mechanisms",
        type=names_from([mechanism.name for mechanism in (*MECHANISMS, *VISION, *SCALED)]),
        help="mechanisms, or constants with factors; comma-separated (default: all)",
    )
    parser.add_argument(
        "--regimes",
        type=names_from(REGIMES),
        default=DEFAULT_REGIMES,
        help=f"comma-separated (default: {DEFAULT_REGIMES})",
    )
    parser.add_argument(
        "--controls",
        type=names_from(controls.controls()),
        default="",
        help="kinds of `bench controls`, comma-separated (default: none)",
    )
    parser.add_argument(
        "--labels", type=label_shares, default={}, help="labels drawn, as for `bench real`"
    )
    parser.add_argument("--seeds", type=int, default=3, help="networks per regime (default 3)")
    parser.add_argument(
        "--scale", type=float, default=0.3, help="length of the simulated recordings (default 0.3)"
    )
    parser.add_argument("--json", type=Path, metavar="FILE")
    return parser.parse_args(argv)
