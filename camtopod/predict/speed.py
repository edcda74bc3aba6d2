"""Time windows of a prediction for an object of known or unknown pace, read off a topology version
(see `slowness`).
"""

from __future__ import annotations

import math

from camtopod.records import Topology
from camtopod.topology import (
    LAG_SECONDS_MIN,
    LAG_STEP,
    SLOWNESS_MAX,
    SMOOTHING_SD_BINS,
    STAY_SECONDS_MIN,
)

NORMAL_Q90 = 1.2816
SHARP_MIN = 0.5
"""Smoothing is not taken to have widened a window by more than makes up this share of it."""
_WIDENED = tuple(
    (least, (NORMAL_Q90 * LAG_STEP * sd_bins) ** 2) for least, sd_bins in SMOOTHING_SD_BINS
)


class Paces:
    """The learned pace of a site; without one, windows are as they are."""

    def __init__(self, topology: Topology) -> None:
        index = {zone.id: k for k, zone in enumerate(topology.zones)}
        pace = topology.model and topology.model.pace
        self._pace = pace or None
        self._usual = {
            (index[way.entry], index[way.exit]): way.stay for way in (pace.ways if pace else [])
        }

    def window(
        self,
        entry: int | None,
        left: int,
        stay: float | None,
        transitions: float,
        q10: float,
        q50: float,
        q90: float,
    ) -> tuple[float, float, float]:
        """Quantiles in seconds after the exit, from those of an object of usual pace.

        ``entry``, ``left``: zones (indices) of a passage that took ``stay`` seconds; None where
        unknown. ``transitions``: how many the quantiles rest on, which says how much they were
        smoothed. Transit times were learned by the mean slowness of the views before and after. The
        one before is known at best; the other is expected to be a share of it, and the rest of what
        it may be widens the window.
        """
        return self.at_pace(self.of_passage(entry, left, stay), transitions, q10, q50, q90)

    def of_passage(
        self, entry: int | None, left: int, stay: float | None
    ) -> tuple[float, float] | None:
        """What a passage says of every window after it: the factor of its times, and by how much
        (log scale) it is wider; None where there is nothing to say.
        """
        if self._pace is None:
            return None
        usual = self._usual.get((entry, left)) if entry is not None else None
        r, sd = self._pace.correlation, self._pace.sd
        if usual is None or stay is None:
            expected, doubt = 0.0, sd * math.sqrt((1.0 + r) / 2.0)
        else:
            slow = math.log(max(stay, STAY_SECONDS_MIN) / usual)
            expected = min(max(slow, -SLOWNESS_MAX), SLOWNESS_MAX) * (1.0 + r) / 2.0
            doubt = sd * math.sqrt(1.0 - r * r) / 2.0
        return math.exp(self._pace.scaling * expected), NORMAL_Q90 * self._pace.scaling * doubt

    def at_pace(
        self,
        pace: tuple[float, float] | None,
        transitions: float,
        q10: float,
        q50: float,
        q90: float,
    ) -> tuple[float, float, float]:
        """`window` for a pace as of `of_passage`."""
        if pace is None or q50 <= LAG_SECONDS_MIN:
            return q10, q50, q90  # short lags do not scale with speed
        factor, wider = pace
        below = _sharp(math.log(q50 / min(max(q10, LAG_SECONDS_MIN), q50)), transitions)
        above = _sharp(math.log(q90 / q50), transitions)
        low = q50 * math.exp(-math.hypot(below, wider)) if q10 > 0 else q10
        return low * factor, q50 * factor, q50 * math.exp(math.hypot(above, wider)) * factor


def _sharp(width: float, transitions: float) -> float:
    """Width (log scale) of a quantile that smoothing the hazards had widened."""
    few = 0
    while transitions < _WIDENED[few][0]:
        few += 1
    return math.sqrt(max(width**2 - _WIDENED[few][1], (SHARP_MIN * width) ** 2))
