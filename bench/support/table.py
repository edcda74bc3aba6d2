"""The table of `bench.quality`: means over networks with standard errors, and the targets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bench.baselines.closest import LITERAL
from bench.baselines.findings import Ranked, Tuned, at, tune
from bench.support.figures import line_of
from bench.support.measure import CLOCK_SECONDS_MAX, OURS, Record
from bench.support.targets import LINKED, TARGETS, Target
from camtopod.arrays import Floats

TITLE, CELL = 72, 16
"""Widths of the first column and of the others."""

ROWS = {
    "zones_right": "zones right, share of cameras",
    "precision": "links, precision",
    "recall": "links, recall",
    "f1": "links, F1",
    "false_links": "false links",
    "silent": "runs without any, share",
    "median_error": "transit median, relative error",
    "median_error_mean": "  mean over the links",
    "recorded_median_error": "  against the recording's own medians",
    "transit_covered": "  within 1.96 stated sd (0.95 is right)",
    "transit_mean_covered": "transit mean within 1.96 sd (0.95)",
    "pair_f1": "pairs of cameras, F1",
    "relation_right": "relation of camera pairs right",
    "top1": "next camera, top-1",
    "told_top1": "  oracle, same zones",
    "top1_ratio": "  ours / oracle",
    "top3": "next camera, top-3",
    "told_top3": "  oracle, same zones",
    "top3_ratio": "  ours / oracle",
    "log_loss": "log loss, nats",
    "told_log_loss": "  oracle, same zones",
    "log_loss_above": "  ours - oracle",
    "calibration_error": "calibration error, all outcomes",
    "told_calibration_error": "  oracle, same zones",
    "first_calibration_error": "calibration error, first guess",
    "first_calibration_floor": "  expected if all are calibrated",
    "told_first_calibration_error": "  oracle, same zones",
    "first_calibration_error_all": "  ours, all exits, with clutter",
    "window_coverage": "arrivals within q10..q90 (0.8 is right)",
    "clock_error": "clock offsets, largest error, s",
    "clock_error_mean": "  mean error, s",
    "clocks_right": f"  within {CLOCK_SECONDS_MAX:g} s, share of cameras",
    "clocks_covered": "  within 1.96 stated sd (0.95 is right)",
    "prediction_ms": "milliseconds a prediction",
    "events": "events",
    "events_per_second": "events a second",
    "seconds": "seconds of processor time to learn",
}
"""Titles of camtopod's figures, in order."""
TARGET_TITLES = {
    "silent": "runs without a false link",
    "top1_ratio": "top-1, share of the oracle's",
    "top3_ratio": "top-3, share of the oracle's",
    "log_loss_above": "log loss above the oracle's",
}
"""Titles of targets, where they differ from those of the figures."""


def tables(records: Sequence[Record], regimes: Sequence[str]) -> list[str]:
    """Return all lines."""
    common = _common_thresholds(records)
    lines = []
    for regime in regimes:
        part = [record for record in records if record.regime == regime]
        if part:
            lines += [*_ours(regime, part), *_links(part, common), *_zones(part), *_next(part), ""]
    return [*lines, *_overview(records, regimes), "", *_targets(records), "", *_seconds(records)]


def figure_lines(records: Sequence[Record], regimes: Sequence[str]) -> list[str]:
    """Return the lines of `bench.support.figures`: each mean of each regime and mode."""
    lines = []
    for regime in regimes:
        part = [record for record in records if record.regime == regime]
        for method in OURS:
            for name in ROWS:
                values = np.array(_values(part, method, name), dtype=float)
                values = values[np.isfinite(values)]
                if len(values):
                    lines.append(
                        line_of(f"{regime}, {method}, {name}", float(values.mean()), _error(values))
                    )
    return lines


def _error(values: Floats) -> float:
    """Return the standard error of a mean; nan for a single value."""
    return float(values.std(ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan


def mean_and_error(values: Sequence[float] | Floats) -> str:
    """Return mean and standard error of the known values, as ``0.982 ±0.004``; ``-`` for none."""
    finite = np.array(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    if not len(finite):
        return "-"
    digits = 0 if abs(finite.mean()) >= 100 else 3
    error = f" ±{_error(finite):.{digits}f}" if len(finite) > 1 else ""
    return f"{finite.mean():.{digits}f}{error}"


def _values(records: Sequence[Record], method: str, name: str) -> list[float]:
    """Return a figure of one method on each network."""
    part = [record for record in records if record.method == method]
    return [record.seconds if name == "seconds" else record.get(name) for record in part]


def _ours(regime: str, records: Sequence[Record]) -> list[str]:
    """Return the lines of camtopod in its modes."""
    seeds = len({record.seed for record in records})
    lines = [
        f"== {regime}: {seeds} network{'s' if seeds > 1 else ''}",
        f"{'':38}" + "".join(f"{m:>20}" for m in OURS),
    ]
    for name, title in ROWS.items():
        cells = [mean_and_error(_values(records, method, name)) for method in OURS]
        if any(cell != "-" for cell in cells):
            lines.append(f"{title:38}" + "".join(f"{cell:>20}" for cell in cells))
    return lines if len(lines) > 2 else lines[:1]


class _Choice(NamedTuple):
    """A variant of a baseline and a threshold."""

    variant: str
    threshold: float


def _ranked(records: Sequence[Record]) -> dict[str, dict[str, list[Ranked]]]:
    """Return method -> variant -> networks."""
    result: dict[str, dict[str, list[Ranked]]] = {}
    for record in records:
        for variant, network in record.ranked.items():
            result.setdefault(record.method, {}).setdefault(variant, []).append(network)
    return result


def _best(variants: dict[str, list[Ranked]]) -> tuple[str, Tuned]:
    """Return the variant with the best mean F1, and its figures at its best threshold."""
    tuned = {variant: tune(networks) for variant, networks in variants.items()}
    best = max(tuned, key=lambda variant: float(tuned[variant].f1.mean()))
    return best, tuned[best]


def _common_thresholds(records: Sequence[Record]) -> dict[str, _Choice]:
    """Return by method the variant and threshold with the best mean F1 over all networks.

    The networks are those of `LINKED` regimes if there are any, else all that have links.
    """
    result = {}
    usual = [record for record in records if record.regime in LINKED]
    for method, variants in _ranked(usual or records).items():
        with_links = {
            variant: [n for n in networks if n.walked] for variant, networks in variants.items()
        }
        if any(with_links.values()):
            variant, tuned = _best(with_links)
            result[method] = _Choice(variant, tuned.threshold)
    return result


def _row(title: str, cells: Sequence[str]) -> str:
    return f"{title:{TITLE}}" + "".join(f"{cell:>{CELL}}" for cell in cells)


def _links(records: Sequence[Record], common: dict[str, _Choice]) -> list[str]:
    """Return the lines of the baselines for links."""
    by_method = _ranked(records)
    if not by_method:
        return []
    heads = ("F1", "precision", "recall", "transit error", "F1, one for all", "runs without")
    lines = [_row("links of baselines, threshold chosen on the truth", heads)]
    for method, variants in by_method.items():
        variant, tuned = _best(variants)
        networks = variants[variant]
        cells = ["-"] * 5
        if any(network.walked for network in networks):
            cells = [
                mean_and_error(values)
                for values in (tuned.f1, tuned.precision, tuned.recall, tuned.error)
            ]
            cells.append("-")
        if method in common:
            choice = common[method]
            networks = variants[choice.variant]
            if cells[0] != "-":
                cells[4] = mean_and_error(at(networks, choice.threshold).f1)
            silent = [max(n.score, default=-np.inf) < choice.threshold for n in networks]
            cells.append(f"{np.mean(silent):.2f}")
        suffix = f", {variant}" if cells[0] != "-" else ""
        lines.append(_row(f"  {method.removeprefix('links: ')}{suffix}", cells))
        if LITERAL in variants and cells[0] != "-":
            cells = [
                mean_and_error(_values(records, method, name))
                for name in ("f1", "precision", "recall")
            ]
            lines.append(_row("  the same as printed, Var(d) <= 1", cells))
    oracle = mean_and_error(_values(records, "transit: told identities", "median_error"))
    return [*lines, _row("  oracle, median of the recorded times", ["", "", "", oracle])]


def _zones(records: Sequence[Record]) -> list[str]:
    """Return the lines of the baselines for zones."""
    methods = sorted({record.method for record in records if record.method.startswith("zones: ")})
    lines = ["zones of baselines, best variant on the truth"] if methods else []
    for method in methods:
        names = [name for record in records if record.method == method for name in record.figures]
        values = {name: _values(records, method, name) for name in dict.fromkeys(names)}
        best = max(values, key=lambda name: float(np.mean(values[name])))
        title = f"  {method.removeprefix('zones: ')}, {best}"
        lines.append(f"{title:58}{mean_and_error(values[best]):>16}")
    return lines


def _next(records: Sequence[Record]) -> list[str]:
    """Return the lines of the oracles for the next camera."""
    methods = sorted({record.method for record in records if record.method.startswith("next: ")})
    lines = (
        [f"{'next camera, oracles':58}{'top-1':>16}{'top-3':>16}{'log loss':>16}"]
        if methods
        else []
    )
    for method in methods:
        cells = [
            mean_and_error(_values(records, method, name)) for name in ("top1", "top3", "log_loss")
        ]
        title = f"  {method.removeprefix('next: ')}"
        lines.append(f"{title:58}" + "".join(f"{cell:>16}" for cell in cells))
    return lines


def _overview(records: Sequence[Record], regimes: Sequence[str]) -> list[str]:
    """Return F1 of links by method and regime, ours first.

    It is F1 of camera pairs where the truth has no zones.
    """
    methods = [*OURS, *_ranked(records)]
    lines = [
        _row(
            "links, F1",
            [method.removeprefix("links: ").split(" (")[0][: CELL - 1] for method in methods],
        )
    ]
    for regime in regimes:
        part = [record for record in records if record.regime == regime]
        of_pairs = not np.isfinite(
            [record.get("f1") for record in part if record.method in OURS]
        ).any()
        cells = [
            mean_and_error(_values(part, method, "pair_f1" if of_pairs else "f1"))
            for method in OURS
        ]
        by_method = _ranked(part)
        for method in methods[len(OURS) :]:
            networks = [
                network for group in by_method.get(method, {}).values() for network in group
            ]
            has_links = any(network.walked for network in networks)
            cells.append(mean_and_error(_best(by_method[method])[1].f1) if has_links else "-")
        if any(cell != "-" for cell in cells):
            lines.append(_row(f"  {regime}{', pairs of cameras' if of_pairs else ''}", cells))
    return lines if len(lines) > 1 else []


def _targets(records: Sequence[Record]) -> list[str]:
    """Return the lines of the targets."""
    lines = [f"{'to reach (mean over networks)':58}{'':>10}" + "".join(f"{m:>26}" for m in OURS)]
    for target in TARGETS:
        part = [record for record in records if record.regime == target.regime]
        cells = [_reached(target, _values(part, method, target.figure)) for method in OURS]
        if any(cells):
            goal = f"{'>=' if target.at_least else '<='} {target.value:g}"
            title = f"{target.regime}: {TARGET_TITLES.get(target.figure, ROWS[target.figure])}"
            lines.append(f"{title:58}{goal:>10}" + "".join(f"{cell:>26}" for cell in cells))
    return lines if len(lines) > 1 else []


def _reached(target: Target, values: Sequence[float]) -> str:
    """Return the mean of a figure and whether it reaches the target."""
    finite = [value for value in values if math.isfinite(value)]
    if not finite:
        return ""
    mean = float(np.mean(finite))
    is_reached = mean >= target.value if target.at_least else mean <= target.value
    return f"{mean_and_error(finite)} {'yes' if is_reached else 'NO'}"


def _seconds(records: Sequence[Record]) -> list[str]:
    """Return the processor seconds a network of every method, mean and longest."""
    lines = [f"{'seconds of processor time a network':58}{'mean':>10}{'longest':>10}"]
    for method in dict.fromkeys(record.method for record in records):
        seconds = [record.seconds for record in records if record.method == method]
        lines.append(f"  {method:56}{np.mean(seconds):>10.2f}{max(seconds):>10.2f}")
    return lines
