"""Slowness of objects, and how far it persists from one view to the next.

Slowness is the log of a passage's dwell time over the median dwell time of passages between the
same two zones (of entry and of exit); it is nan if unknown. Speeds vary more between objects than
within one, so a slow passage through one view predicts a long transit time to the next view and a
slow passage there. How strongly it does is estimated from those transitions of the site that are
most certain, and used only as far as it is significant: where tracks are missing or speeds do not
persist, slowness has no effect.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats
from camtopod.topology import DWELL_SECONDS_MIN, LAG_SECONDS_MIN, SLOWNESS_MAX, LagBins

USUAL_PASSAGES_MIN = 5
"""Least passages between two zones whose median dwell time counts as usual."""
SURE_RESPONSIBILITY = 0.5
"""A candidate with more than this responsibility counts as a transition in the estimates here."""
SURE_TRANSITIONS_MIN = 30
"""Least transitions for an estimate, and least degrees of freedom of the slope in `_scaling`."""
SIGNIFICANT_SD = 2.0
"""Standard errors subtracted from each estimate, so that only a significant one has an effect."""
AGREEMENT_MAX = 1e9
"""Largest likelihood ratio that two slownesses give for being of one object."""


class Persistence(NamedTuple):
    """How far speed persists from one view to the next.

    scaling: slope of the log lag on slowness; lags are proportional to exp(scaling * slowness).
    correlation: of the slownesses of one object in two successive views.
    sd: standard deviation of slowness.
    """

    scaling: float
    correlation: float
    sd: float


NO_PERSISTENCE = Persistence(0.0, 0.0, 1.0)
"""Slowness in one view says nothing of the lag to the next view or of the slowness there."""


def usual_dwell_times(
    source: NDArray[np.int32], target: NDArray[np.int32], stay: Floats
) -> dict[tuple[int, int], float]:
    """Return the median dwell time in seconds by (zone of entry, zone of exit).

    source, target (n,): zones of entry and exit of passages.
    stay (n, seconds): their dwell times.

    Pairs of zones with less than `USUAL_PASSAGES_MIN` passages are left out. The median is that of
    the logs.
    """
    stays: dict[tuple[int, int], list[float]] = {}
    for way, seconds in zip(
        zip(source.tolist(), target.tolist(), strict=True), stay.tolist(), strict=True
    ):
        stays.setdefault(way, []).append(max(seconds, DWELL_SECONDS_MIN))
    return {
        way: math.exp(float(np.median(np.log(each))))
        for way, each in stays.items()
        if len(each) >= USUAL_PASSAGES_MIN
    }


def slowness(
    source: NDArray[np.int32], target: NDArray[np.int32], stay: Floats, zones: int
) -> Floats:
    """Return the slowness (n,) of passages, nan where there are too few of the same two zones.

    source, target (n,): zones of entry and exit, from 0 to ``zones`` - 1.
    stay (n, seconds): dwell times.
    """
    if len(stay) == 0:
        return np.zeros(0)

    # Number the pairs of zones.
    log_stay = np.log(np.maximum(stay, DWELL_SECONDS_MIN))
    way, count = np.unique(
        source.astype(np.int64) * zones + target, return_inverse=True, return_counts=True
    )[1:]

    # Median log dwell time of each pair.
    order = np.lexsort((log_stay, way))
    first = np.cumsum(count) - count
    low, high = first + (count - 1) // 2, first + count // 2
    median = 0.5 * (log_stay[order[low]] + log_stay[order[high]])

    # Slowness relative to it.
    relative = np.clip(log_stay - median[way], -SLOWNESS_MAX, SLOWNESS_MAX)
    return np.where(count[way] >= USUAL_PASSAGES_MIN, relative, np.nan)


def estimate_persistence(
    left: Floats, came: Floats, lag: Floats, pair: NDArray[np.int32], responsibility: Floats
) -> Persistence:
    """Estimate how far speed persists from candidates (M,).

    left, came: slowness of the passages before the departure and after the arrival; nan if unknown.
    lag: seconds from the departure to the arrival.
    pair: index of the pair of zones.
    responsibility: probability that the candidate is of one object.
    """
    # Transitions of which both slownesses are known.
    sure = responsibility > SURE_RESPONSIBILITY
    both = sure & np.isfinite(left) & np.isfinite(came)
    n = int(both.sum())
    if n < SURE_TRANSITIONS_MIN:
        return NO_PERSISTENCE
    sd = float(np.sqrt(np.mean(np.concatenate((left[both] ** 2, came[both] ** 2)))))

    # Correlation, less its uncertainty. If all passages take equally long, as those of machines,
    # there is none.
    varies = min(left[both].std(), came[both].std()) > 0
    observed = float(np.corrcoef(left[both], came[both])[0, 1]) if varies else 0.0
    correlation = min(max(observed - SIGNIFICANT_SD / math.sqrt(n), 0.0), 0.95)
    return Persistence(
        _scaling(mean_slowness(left, came), lag, pair, sure), correlation, max(sd, 0.05)
    )


def _scaling(slow: Floats, lag: Floats, pair: NDArray[np.int32], sure: NDArray[np.bool_]) -> float:
    """Estimate the slope of the log lag on slowness within pairs of zones.

    The standard error is subtracted `SIGNIFICANT_SD` times; the result is 0 if not significant.
    """
    # Transitions of known slowness, relative to the means of their pair of zones.
    rows = np.flatnonzero(sure & np.isfinite(slow) & (lag > LAG_SECONDS_MIN))
    if len(rows) < SURE_TRANSITIONS_MIN:
        return 0.0
    group = np.unique(pair[rows], return_inverse=True)[1]
    size = np.bincount(group)
    x, y = slow[rows], np.log(lag[rows])
    x = x - (np.bincount(group, x) / size)[group]
    y = y - (np.bincount(group, y) / size)[group]

    # Least squares.
    freedom = len(rows) - len(size) - 1
    spread = float(np.sum(x * x))
    if freedom < SURE_TRANSITIONS_MIN or spread <= 0:
        return 0.0
    slope = float(np.sum(x * y)) / spread
    error = math.sqrt(float(np.sum((y - slope * x) ** 2)) / freedom / spread)
    return min(max(slope - SIGNIFICANT_SD * error, 0.0), 1.0)


def mean_slowness(left: Floats, came: Floats) -> Floats:
    """Return the mean of the two slownesses, the one that is known, or nan."""
    both = 0.5 * (left + came)
    return np.where(np.isfinite(both), both, np.where(np.isfinite(left), left, came))


def adjusted_lag(lag: Floats, slow: Floats, scaling: float, bins: LagBins) -> Floats:
    """Return the lags (M,) that objects of usual speed would have had.

    lag (M, seconds), slow (M,): lag and slowness of candidates.

    Lags up to `LAG_SECONDS_MIN`, and those of unknown slowness, are not scaled; all are clipped to
    the range of ``bins``.
    """
    factor = np.where(np.isfinite(slow) & (lag > LAG_SECONDS_MIN), np.exp(-scaling * slow), 1.0)
    return np.clip(lag * factor, bins.lag_min, bins.lag_max)


def agreement(left: Floats, came: Floats, p: Persistence) -> Floats:
    """Return the likelihood ratio (M,) of two slownesses for one object; 1 if either is unknown."""
    if p.correlation <= 0:
        return np.ones(len(left))
    u, v, r = left / p.sd, came / p.sd, p.correlation
    exponent = (2.0 * r * u * v - r * r * (u * u + v * v)) / (2.0 * (1.0 - r * r))
    ratio: Floats = np.exp(np.minimum(exponent, np.log(AGREEMENT_MAX))) / np.sqrt(1.0 - r * r)
    return np.where(np.isfinite(ratio), np.minimum(ratio, AGREEMENT_MAX), 1.0)
