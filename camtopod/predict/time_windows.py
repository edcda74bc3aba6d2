"""Time windows from masses over lag bins, and the share of each bin that is still possible.

A time window says when an object probably appears at a zone: the 10 %, 50 % and 90 % quantiles of
the lag. As time passes without a matching arrival, lags that have passed are no longer possible
(`unknown_share`).

Windows are adjusted to an object's speed. The slowness of an object is the log of its dwell time
over the usual one for the same zones of entry and exit (`camtopod.learn.traffic.speed`). It
persists in part from one view to the next; the topology version says how far. `PaceModel` computes
the expected `PassagePace` of an object after a passage, and `windows_at_pace` changes time windows
accordingly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from camtopod.arrays import Floats
from camtopod.columns import numbers
from camtopod.predict.hazards import model_of
from camtopod.predict.outcomes import NORMAL_Q90
from camtopod.records import Topology
from camtopod.topology import (
    DWELL_SECONDS_MIN,
    LAG_SECONDS_MIN,
    LAG_STEP,
    SLOWNESS_MAX,
    SMOOTHING_SD_BINS,
)

WINDOW = (0.1, 0.5, 0.9)
"""Quantiles of the lag at which a time window has its beginning, median and end."""
TIMED_TRANSITIONS_MIN = float(len(WINDOW))
"""Least number of transitions that tell a time window; of fewer it is but the prior's."""
_SMOOTHING_TRANSITIONS = np.array([least for least, _ in SMOOTHING_SD_BINS])
"""Least number of transitions for each kernel of `camtopod.topology.smooth`, descending."""
_SMOOTHING_WIDTHS = np.array([NORMAL_Q90 * LAG_STEP * sd_bins for _, sd_bins in SMOOTHING_SD_BINS])
"""Distance from the median to the 0.9 quantile of each of these kernels, difference of logs."""


def scale_lags(lags: Floats, factor: float) -> Floats:
    """Return lags (n, seconds) times a factor, except for lags before the exit.

    factor: expected transit time of an object over the usual one; lags before the exit do not scale
        with speed.
    """
    return lags if factor == 1.0 else np.where(lags > 0, factor * lags, lags)


def unknown_share(edges: Floats, elapsed: float, memory_start: float, shift: Floats) -> Floats:
    """Return the share of each lag bin in which an arrival would not be known, (targets, bins).

    edges (bins + 1, seconds): edges of the lag bins.
    elapsed: seconds since the exit.
    memory_start: time, in seconds after the exit, since which all arrivals are remembered; below 0
        for one before the exit.
    shift (targets, seconds): to be added to a lag to get the seconds from the exit to the report of
        the arrival.

    An arrival would not be known if it is still to come, or if it is not remembered.
    """
    # The seconds of each bin that are known, in lags of each target.
    by_target = shift[:, None]
    begin = np.maximum(edges[:-1], memory_start - by_target)
    end = np.minimum(edges[1:], elapsed - by_target)
    share: Floats = 1.0 - np.maximum(end - begin, 0.0) / np.diff(edges)
    return share


def quantiles(mass: Floats, edges: Floats) -> Floats:
    """Return the lags below which the shares `WINDOW` of each target's mass lie, (targets, 3).

    mass (targets, bins): mass of each lag bin; the sum of each row is above 0.
    edges (bins + 1, seconds): edges of the lag bins.

    Within a bin, the mass is taken as uniform.
    """
    # Mass below each edge, and the mass to be reached.
    below = np.zeros((len(mass), mass.shape[1] + 1))
    np.cumsum(mass, axis=1, out=below[:, 1:])
    levels = np.array(WINDOW) * below[:, -1:]

    # Bin in which that mass is reached.
    row = np.arange(len(mass))[:, None]
    at = np.argmax(below[:, None, :] > levels[:, :, None], axis=2) - 1

    # Interpolate within the bin.
    seconds_per_mass = (edges[at + 1] - edges[at]) / (below[row, at + 1] - below[row, at])
    lags: Floats = edges[at] + seconds_per_mass * (levels - below[row, at])
    return lags


class PassagePace(NamedTuple):
    """The expected transit time of an object to the next view, relative to the usual one."""

    factor: float
    """Expected transit time over the usual one."""
    spread: float
    """Uncertainty of ``factor``: log of its 0.9 quantile over its median."""


class PaceModel:
    """Persistence of speed and usual dwell times at a site, as a topology version has them.

    If the version has none, windows are not adjusted.
    """

    def __init__(self, topology: Topology) -> None:
        self._pace = model_of(topology).pace
        self._usual_dwell: dict[tuple[int | None, int], float] = {}
        if self._pace is not None:
            entry, exit_ = (
                numbers(raw, np.int32, -1).tolist() for raw in (self._pace.entry, self._pace.exit)
            )
            stay = numbers(self._pace.stay, np.float32, len(entry)).tolist()
            self._usual_dwell.update(zip(zip(entry, exit_, strict=True), stay, strict=True))

    def of_passage(self, entry: int | None, exit_: int, dwell: float | None) -> PassagePace | None:
        """Return the expected pace of an object after a passage; None if the version has none.

        entry, exit_: zones (indices) of the passage; the entry is None if unknown.
        dwell (seconds): duration of the passage; None if unknown.

        The log of a transit time was learned as proportional to the mean of the slownesses in the
        views before and after. At best the slowness before is known. The slowness after is expected
        to be a share of it, and the rest of its variance widens the window.
        """
        if self._pace is None:
            return None
        usual = self._usual_dwell.get((entry, exit_))
        correlation = self._pace.correlation
        sd = self._pace.sd

        # Mean slowness of the two views, and its standard deviation.
        if usual is None or dwell is None:
            expected = 0.0
            uncertain = sd * math.sqrt((1.0 + correlation) / 2.0)
        else:
            slowness = math.log(max(dwell, DWELL_SECONDS_MIN) / usual)
            slowness = min(max(slowness, -SLOWNESS_MAX), SLOWNESS_MAX)
            expected = slowness * (1.0 + correlation) / 2.0
            uncertain = sd * math.sqrt(1.0 - correlation**2) / 2.0
        scaling = self._pace.scaling
        return PassagePace(math.exp(scaling * expected), NORMAL_Q90 * scaling * uncertain)


def windows_at_pace(pace: PassagePace | None, lags: Floats, transitions: Floats) -> Floats:
    """Return the time windows (n, 3, seconds) of an object of a given pace.

    pace: the expected pace; None for the usual pace.
    lags (n, 3, seconds): windows of an object of usual pace, as 0.1, 0.5 and 0.9 quantiles of lags.
    transitions (n,): number of transitions from which the lags were learned; it decides how widely
        they have been smoothed.
    """
    if pace is None:
        return lags

    # Widths (n, 2) of the window below and above the median, log scale.
    logs = np.log(np.maximum(lags, LAG_SECONDS_MIN))
    width = logs[:, 1:] - logs[:, :-1]

    # Subtract the width that smoothing has added, half at most, and add the pace's uncertainty.
    smoothing = np.count_nonzero(transitions[:, None] < _SMOOTHING_TRANSITIONS, axis=1)
    smoothing_width = _SMOOTHING_WIDTHS[smoothing, None]
    width = np.sqrt(np.maximum(width**2 - smoothing_width**2, (0.5 * width) ** 2) + pace.spread**2)

    # The quantiles at this pace; a quantile before the exit is scaled only.
    result = lags * pace.factor
    result[:, 2] = result[:, 1] * np.exp(width[:, 1])
    low = result[:, 1] * np.exp(-width[:, 0])
    result[:, 0] = np.where(lags[:, 0] > 0, low, result[:, 0])

    # Short lags do not scale with speed.
    return np.where(lags[:, 1:2] > LAG_SECONDS_MIN, result, lags)
