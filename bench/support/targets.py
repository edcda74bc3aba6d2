"""Target values of the figures, as means over at least ten networks."""

from __future__ import annotations

from typing import NamedTuple


class Target(NamedTuple):
    """A value to reach in one regime.

    ``figure`` is the name of a figure of a `bench.support.measure.Record`.
    """

    regime: str
    figure: str
    value: float
    at_least: bool = True


RHYTHMS = ("rhythm", "rhythm-sparse", "rhythm-medium", "rhythm-dense")
LINKED = ("sparse", "medium", "dense", *RHYTHMS, "faulty", "short", "overlapped")
"""Regimes with targets for transit times and predictions."""
TARGETS = (
    Target("zones-10", "zones_right", 0.97),
    Target("zones-30", "zones_right", 0.97),
    Target("sparse", "f1", 0.98),
    Target("medium", "f1", 0.98),
    Target("dense", "f1", 0.94),
    *(Target(regime, "f1", 0.98) for regime in RHYTHMS),
    Target("faulty", "f1", 0.96),
    Target("no-links", "silent", 0.95),
    Target("short", "f1", 0.94),
    *(Target(regime, "median_error", 0.02, at_least=False) for regime in LINKED),
    Target("overlapped", "relation_right", 0.98),
    *(Target(regime, figure, 0.98) for regime in LINKED for figure in ("top1_ratio", "top3_ratio")),
    *(Target(regime, "log_loss_above", 0.1, at_least=False) for regime in LINKED),
    *(
        Target(regime, figure, 0.02, at_least=False)
        for regime in LINKED
        for figure in ("calibration_error", "first_calibration_error")
    ),
    Target("clocks", "clock_error", 0.5, at_least=False),
    Target("road", "top1_ratio", 0.95),
    Target("hall", "top1_ratio", 0.90),
    Target("crowd", "top1_ratio", 0.80),
    Target("walkway", "top1_ratio", 0.95),
)
