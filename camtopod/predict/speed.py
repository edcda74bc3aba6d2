"""Adjust the time windows of a prediction to an object's speed, read off a topology version.

Slowness is the log of a dwell time over the usual one of its route through the view
(`camtopod.learn.traffic.speed`). It persists in part from one view to the next.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from camtopod.arrays import Floats
from camtopod.records import Topology
from camtopod.topology import (
    DWELL_SECONDS_MIN,
    LAG_SECONDS_MIN,
    LAG_STEP,
    SLOWNESS_MAX,
    SMOOTHING_SD_BINS,
)

NORMAL_Q90 = 1.2816
"""0.9 quantile of the standard normal distribution."""
SHARP_MIN = 0.5
"""Least share of a window's width that is left when the effect of smoothing is taken out."""
_SMOOTHING_TRANSITIONS = np.array([least for least, _ in SMOOTHING_SD_BINS])
"""Least number of transitions for each amount of smoothing, descending."""
_SMOOTHING_WIDTHS = np.array([NORMAL_Q90 * LAG_STEP * sd_bins for _, sd_bins in SMOOTHING_SD_BINS])
"""Distance from the median to the 0.9 quantile that each amount of smoothing adds (log scale)."""


class Pace(NamedTuple):
    """An object's expected speed on its way to the next view, relative to the usual speed."""

    factor: float
    """Expected transit time over the usual one."""
    spread: float
    """Uncertainty of ``factor``: its 0.9 quantile over the median, log scale."""


class PaceModel:
    """The learned persistence of speed at a site; without one, windows are not adjusted."""

    def __init__(self, topology: Topology) -> None:
        index = {zone.id: k for k, zone in enumerate(topology.zones)}
        self._pace = topology.model.pace if topology.model else None
        self._usual_dwell = {
            (index[route.entry], index[route.exit]): route.stay
            for route in (self._pace.ways if self._pace else [])
        }

    def of_passage(self, entry: int | None, exit_: int, dwell: float | None) -> Pace | None:
        """Return the pace expected after a passage; None if none has been learned.

        Transit times were learned as proportional to the mean slowness of the views before and
        after. At best the slowness before is known. The one after is expected to be a share of it;
        the rest of its variance widens the window.

        entry, exit_: zones (indices) of the passage; the entry is None if unknown.
        dwell (seconds): duration of the passage; None if unknown.
        """
        if self._pace is None:
            return None
        usual = self._usual_dwell.get((entry, exit_)) if entry is not None else None
        correlation, sd = self._pace.correlation, self._pace.sd

        # Mean slowness of the two views, and its standard deviation.
        if usual is None or dwell is None:
            expected, uncertain = 0.0, sd * math.sqrt((1.0 + correlation) / 2.0)
        else:
            slowness = math.log(max(dwell, DWELL_SECONDS_MIN) / usual)
            slowness = min(max(slowness, -SLOWNESS_MAX), SLOWNESS_MAX)
            expected = slowness * (1.0 + correlation) / 2.0
            uncertain = sd * math.sqrt(1.0 - correlation**2) / 2.0
        scaling = self._pace.scaling
        return Pace(math.exp(scaling * expected), NORMAL_Q90 * scaling * uncertain)


def windows_at_pace(pace: Pace | None, lags: Floats, transitions: Floats) -> Floats:
    """Return the lag quantiles (n, 3) of an object of some pace from those of one of usual pace.

    lags (n, 3, seconds): 0.1, 0.5 and 0.9 quantiles.
    transitions (n,): transitions that the quantiles rest on, which decide how much the hazards
        were smoothed.
    """
    if pace is None:
        return lags

    # Widths (n, 2) of the window below and above the median, log scale.
    bounded = np.maximum(lags, LAG_SECONDS_MIN)
    logs = np.log(bounded)
    width = logs[:, 1:] - logs[:, :-1]

    # Take out what smoothing the hazards has added, and add the uncertainty of the pace.
    smoothing = np.count_nonzero(transitions[:, None] < _SMOOTHING_TRANSITIONS, axis=1)
    added = _SMOOTHING_WIDTHS[smoothing, None]
    width = np.sqrt(np.maximum(width**2 - added**2, (SHARP_MIN * width) ** 2) + pace.spread**2)

    # The quantiles at this pace. Lags before the exit keep their width.
    adjusted = lags * pace.factor
    adjusted[:, 2] = adjusted[:, 1] * np.exp(width[:, 1])
    low = adjusted[:, 1] * np.exp(-width[:, 0])
    adjusted[:, 0] = np.where(lags[:, 0] > 0, low, adjusted[:, 0])

    # Short lags do not scale with speed.
    return np.where(lags[:, 1:2] > LAG_SECONDS_MIN, adjusted, lags)
