"""Measure what each mechanism of the learner is worth: all figures with it and without it.

    python -m bench ablation [--data FOLDER] [--constants] [--mechanisms a,b] [--regimes a,b]
                             [--controls a,b] [--seeds N] [--scale X] [--labels car:.80,van:.12]
                             [--jobs 2] [--json FILE]

Networks are the real ones of `bench real` (none without data), the simulated ones of
`support.regimes`, and those of `bench controls`, whose true links are all known. The first 70 % of
a real or simulated network is learned in one fit, and the rest is scored.

A cost is the figure without the mechanism less the figure with all mechanisms, on the same network.
Costs are positive where the figure is worse: log loss, calibration error and false links that are
higher, links and top-1 that are lower. A mechanism earns its place if its cost is more than two
standard errors on the real networks, or more than two standard errors and more than `REGIME_COST`
on one kind of simulated network.

The figures at the end are what each mechanism is worth: its costs on the real networks as means
over their kinds, with the standard error over kinds, as bench/README shows them.

With ``--constants`` each constant is halved and doubled instead. The last table cross-validates
them: each kind of real network is measured with the value that is best on the other kinds. With
``--labels`` the identities of the real networks draw labels, as in `bench real`.
"""

from __future__ import annotations

import argparse
import contextlib
import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from msgspec import Struct

from bench import controls, real
from bench.support.figures import line_of
from bench.support.jobs import map_tasks
from bench.support.measure import measure as measure_regime
from bench.support.parts import data_parser, folders_in, names_from, write_json
from bench.support.real_options import Options, label_shares
from bench.support.regimes import REGIMES
from camtopod.learn.prediction_model import missed_shares
from camtopod.learn.traffic.speed import NO_PERSISTENCE
from camtopod.topology import LagBins

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


class Mechanism(Struct, frozen=True):
    """A mechanism that can be left out.

    ``replaced`` maps names (``module:name``, below `camtopod`) to their replacements.
    """

    name: str
    replaced: dict[str, Any]


class Task(Struct, frozen=True):
    """One network, learned without one mechanism ("": with all)."""

    mechanism: str
    kind: str
    network: str
    scale: float
    labels: dict[str, float] = {}


def _without_levels(*levels: int) -> Callable[..., Any]:
    """Return a replacement of `Contexts._contexts` in which some levels are always unknown."""
    method = import_module("camtopod.learn.next_camera.contexts").Contexts._contexts

    def contexts_of(self: Any, *arguments: Any) -> Any:
        contexts = method(self, *arguments)
        return [(c, weight * (k not in levels)) for k, (c, weight) in enumerate(contexts)]

    return contexts_of


MECHANISMS = [
    Mechanism(
        "context: entry and block",
        {"learn.next_camera.contexts:Contexts._contexts": _without_levels(0)},
    ),
    Mechanism(
        "context: camera before",
        {"learn.next_camera.contexts:Contexts._contexts": _without_levels(1)},
    ),
    Mechanism(
        "contexts, all", {"learn.next_camera.contexts:Contexts._contexts": _without_levels(0, 1)}
    ),
    Mechanism(
        "speed", {"learn.association.em:estimate_persistence": lambda *arguments: NO_PERSISTENCE}
    ),
    Mechanism("prior: paths are two-way", {"learn.next_camera.prior:RETURNING": 0.0}),
    Mechanism("faint transitions", {"learn.next_camera.fit:FAINT_TRANSITIONS": 0.0}),
    Mechanism(
        "spurious transitions",
        {
            "learn.next_camera.fit:spurious_shares": lambda pair, weight, evidence, *arguments: (
                np.zeros(len(evidence))
            )
        },
    ),
    Mechanism("entry kernels", {"learn.next_camera.entry_kernels:ENTRY_PAIRS_MAX": (0, 0)}),
    Mechanism("overlapping views", {"learn.refit:find_overlapping": lambda *arguments: []}),
    Mechanism(
        "test of overlap",
        {
            "learn.next_camera.fit:negative_without_overlap": lambda problem, c, *arguments: (
                np.zeros(len(c.lag), np.bool_)
            )
        },
    ),
    Mechanism(
        "missed detections, prediction",
        {
            "learn.prediction_model:missed_shares": lambda posterior, scene, bins, shares: (
                missed_shares(posterior, scene, bins, None)
            )
        },
    ),
    Mechanism(
        "missed detections, links",
        {"learn.links.publishing:own_transitions": lambda table, shares: table.transit.total},
    ),
    Mechanism(
        "range of lags is found",
        {"learn.refit:find_lag_bins": lambda *arguments: LagBins(-120.0, 180.0)},
    ),
    Mechanism(
        "labels", {"learn.association.em:estimate_label_persistence": lambda *arguments: 0.0}
    ),
    Mechanism("ways through zones", {"learn.zones.partition:way_contrast": lambda *a: math.inf}),
    Mechanism(
        "rhythm", {"learn.traffic.labelled_events:rhythm_rates": lambda t, zone, even, n: even}
    ),
    Mechanism(
        "activity of the site",
        {
            f"learn.{module}:activity_rates": lambda t, zone, camera, rate: rate
            for module in ("links.cross_validation", "paths.camera_lags")
        },
    ),
    Mechanism(
        "past of a zone by age",
        {"learn.traffic.rhythm:_past_by_age": lambda t, zone, zones: np.zeros((0, len(t)))},
    ),
    Mechanism(
        "common cycle",
        {"learn.refit:without_cycle": lambda problem, fit: (fit, np.full(len(fit.counts), np.nan))},
    ),
    Mechanism(
        "one occasion tells little",
        {
            f"learn.links.{module}:repeated": lambda nats: nats.sum(axis=-1)
            for module in ("significance", "cross_validation")
        },
    ),
    Mechanism("changes", {"learn.refit:find_changes": lambda *arguments: []}),
    Mechanism("over-relaxed EM", {"learn.association.em:STRIDE": 1.0}),
    Mechanism("sparse prior", {"learn.association.joint_fit:SPARSITY": 0.0}),
    Mechanism("second opinion", {"learn.refit:is_wanted": lambda *arguments: False}),
    Mechanism(
        "second opinion between zones", {"learn.paths.opinion:_has_platoons": lambda scene: False}
    ),
    Mechanism(
        "second opinion on links",
        {"learn.refit:with_second_opinion": lambda table, *arguments: table},
    ),
    Mechanism("anywhere", {"predict.anywhere:surplus": lambda *arguments: 0.0}),
    Mechanism("long paths", {"learn.long_paths:find_long_paths": lambda *arguments: []}),
    Mechanism(
        "usual dwell times",
        {"learn.refit:with_usual_dwell_times": lambda departures, through: departures},
    ),
    Mechanism(
        "silent cameras",
        {"predict.reporting:Reporting.is_alive": lambda self: np.ones(len(self._cameras))},
    ),
    Mechanism(
        "seen before the exit",
        {
            "predict.hazards:Hazards.seen_before": lambda self, zone: np.zeros(
                len(self._seen_before), np.bool_
            )
        },
    ),
]
"""The mechanisms that are left out in turn."""

CONSTANTS = (
    ("BACK_OFF_DEPARTURES", ("learn.next_camera.contexts", "predict.contexts")),
    ("RETURNING", ("learn.next_camera.prior",)),
    ("FAINT_TRANSITIONS", ("learn.next_camera.fit",)),
    ("SPREAD", ("learn.next_camera.spurious",)),
    ("CHANCE_PRIOR", ("learn.next_camera.spurious",)),
    ("DEPARTURES_TO_TELL", ("learn.next_camera.spurious",)),
    ("CLEAR_NOISE_SD", ("learn.next_camera.fit", "learn.next_camera.overlapping_views")),
    ("SPARSITY", ("learn.association.joint_fit", "learn.links.cross_validation")),
    ("OUTSIDE_LEAST", ("learn.links.cross_validation", "learn.paths.path_fit")),
    ("OCCASION_SHARE_MAX", ("learn.links.significance",)),
    ("PEAK_NATS", ("learn.links.common_cycle",)),
    ("ACTIVITY_SECONDS", ("learn.traffic.rhythm",)),
    ("CONTRAST_MIN", ("learn.lag_range",)),
    ("SPARE", ("learn.lag_range",)),
    ("WAY_CONTRAST", ("learn.zones.partition",)),
    ("DEPARTURES_PER_ZONE", ("learn.paths.opinion",)),
    ("PLATOON_NATS", ("learn.paths.opinion",)),
)
"""Constants that are halved and doubled: name, and the modules that hold it."""
FACTORS = (0.5, 2.0)
"""Factors by which each constant is scaled."""


def _times(name: str, factor: float) -> str:
    return f"{name} x {factor:g}"


SCALED = [
    Mechanism(
        _times(name, factor),
        {
            f"{module}:{name}": factor * getattr(import_module(f"camtopod.{module}"), name)
            for module in modules
        },
    )
    for name, modules in CONSTANTS
    for factor in FACTORS
]
"""The constants with each factor, in the form of mechanisms."""


def main(argv: Sequence[str]) -> int:
    """Measure, print the tables and return the exit status."""
    arguments = _parse(argv)
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


@contextlib.contextmanager
def without(mechanism: str) -> Iterator[None]:
    """Replace a mechanism ("": none) while the block runs."""
    replacements: dict[str, Any] = {}
    for candidate in (*MECHANISMS, *SCALED):
        if candidate.name == mechanism:
            replacements |= candidate.replaced
    with contextlib.ExitStack() as stack:
        for name, stand_in in replacements.items():
            module, _, path = name.partition(":")
            *owners, attribute = path.split(".")
            owner: Any = import_module(f"camtopod.{module}")
            for part in owners:
                owner = getattr(owner, part)
            stack.enter_context(patch.object(owner, attribute, stand_in))
        yield


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
            costs = [mean for mean in map(_mean, by_kind.values()) if not math.isnan(mean)]
            if costs:
                error = math.nan
                if len(costs) > 1:
                    error = float(np.std(costs, ddof=1) / math.sqrt(len(costs)))
                lines.append(line_of(f"{name}, {figure}", _mean(costs), error))
    return lines


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
        names = ["", *(_times(constant, factor) for factor in FACTORS)]
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
    parser.add_argument(
        "--mechanisms",
        type=names_from([mechanism.name for mechanism in (*MECHANISMS, *SCALED)]),
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
