"""Slowness: how long an object took through a view beside what that way usually takes.

Speeds vary between objects more than within one, so a slow walk through one view foretells a long
transit to the next and a slow walk there. Slowness is the log of a passage's duration over the
median of its way (zone of entry to zone of exit); nan where it is unknown. How much it tells at a
site is estimated from the site's own surest transitions, and used only as far as it is significant:
where tracks are missing or speeds do not persist, nothing changes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats
from camtopod.topology import LAG_SECONDS_MIN, SLOWNESS_MAX, STAY_SECONDS_MIN, LagBins

WAY_PASSAGES_MIN = 5
"""The median of a way counts from this many passages."""
SURE_RESPONSIBILITY = 0.5
SURE_TRANSITIONS_MIN = 30
SIGNIFICANT_SD = 2.0
AGREEMENT_MAX = 1e9
"""However alike two slownesses are, they speak for one object by this factor at most."""


class Persistence(NamedTuple):
    """How speed persists: lags scale with slowness to the power ``scaling``; ``correlation``,
    ``sd`` are of views.
    """

    scaling: float
    correlation: float
    sd: float


NO_PERSISTENCE = Persistence(0.0, 0.0, 1.0)


def usual_stays(
    source: NDArray[np.int32], target: NDArray[np.int32], stay: Floats
) -> dict[tuple[int, int], float]:
    """Median duration in seconds of the ways (zone of entry, zone of exit) that at least
    `WAY_PASSAGES_MIN` took.
    """
    stays: dict[tuple[int, int], list[float]] = {}
    for way, seconds in zip(
        zip(source.tolist(), target.tolist(), strict=True), stay.tolist(), strict=True
    ):
        stays.setdefault(way, []).append(max(seconds, STAY_SECONDS_MIN))
    return {
        way: math.exp(float(np.median(np.log(each))))
        for way, each in stays.items()
        if len(each) >= WAY_PASSAGES_MIN
    }


def slowness(
    source: NDArray[np.int32], target: NDArray[np.int32], stay: Floats, zones: int
) -> Floats:
    """Log slowness (n,) of passages by their zones of entry and exit and their durations in
    seconds.
    """
    if len(stay) == 0:
        return np.zeros(0)
    log_stay = np.log(np.maximum(stay, STAY_SECONDS_MIN))
    way, count = np.unique(
        source.astype(np.int64) * zones + target, return_inverse=True, return_counts=True
    )[1:]
    order = np.lexsort((log_stay, way))
    first = np.cumsum(count) - count
    low, high = first + (count - 1) // 2, first + count // 2
    median = 0.5 * (log_stay[order[low]] + log_stay[order[high]])
    relative = np.clip(log_stay - median[way], -SLOWNESS_MAX, SLOWNESS_MAX)
    return np.where(count[way] >= WAY_PASSAGES_MIN, relative, np.nan)


def persistence(
    left: Floats, came: Floats, lag: Floats, pair: NDArray[np.int32], responsibility: Floats
) -> Persistence:
    """Estimate from candidates (M,): slowness before and after, lag in seconds, pair of zones,
    responsibility.
    """
    sure = responsibility > SURE_RESPONSIBILITY
    both = sure & np.isfinite(left) & np.isfinite(came)
    n = int(both.sum())
    if n < SURE_TRANSITIONS_MIN:
        return NO_PERSISTENCE
    sd = float(np.sqrt(np.mean(np.concatenate((left[both] ** 2, came[both] ** 2)))))
    varies = (
        min(left[both].std(), came[both].std()) > 0
    )  # else every passage there takes equally long: a machine's
    observed = float(np.corrcoef(left[both], came[both])[0, 1]) if varies else 0.0
    correlation = min(max(observed - SIGNIFICANT_SD / math.sqrt(n), 0.0), 0.95)
    return Persistence(_scaling(combined(left, came), lag, pair, sure), correlation, max(sd, 0.05))


def _scaling(slow: Floats, lag: Floats, pair: NDArray[np.int32], sure: NDArray[np.bool_]) -> float:
    """Slope of log lag on slowness within the pairs of zones, less its uncertainty; 0 when not
    significant.
    """
    rows = np.flatnonzero(sure & np.isfinite(slow) & (lag > LAG_SECONDS_MIN))
    if len(rows) < SURE_TRANSITIONS_MIN:
        return 0.0
    group = np.unique(pair[rows], return_inverse=True)[1]
    size = np.bincount(group)
    x, y = slow[rows], np.log(lag[rows])
    x = x - (np.bincount(group, x) / size)[group]
    y = y - (np.bincount(group, y) / size)[group]
    freedom = len(rows) - len(size) - 1
    spread = float(np.sum(x * x))
    if freedom < SURE_TRANSITIONS_MIN or spread <= 0:
        return 0.0
    slope = float(np.sum(x * y)) / spread
    error = math.sqrt(float(np.sum((y - slope * x) ** 2)) / freedom / spread)
    return min(max(slope - SIGNIFICANT_SD * error, 0.0), 1.0)


def combined(left: Floats, came: Floats) -> Floats:
    """Mean of the two slownesses, or the one that is known, or nan."""
    both = 0.5 * (left + came)
    return np.where(np.isfinite(both), both, np.where(np.isfinite(left), left, came))


def adjusted_lag(lag: Floats, slow: Floats, scaling: float, bins: LagBins) -> Floats:
    """Lags (M,) as an object of usual speed would have them; those up to `LAG_SECONDS_MIN` as they
    are.
    """
    factor = np.where(np.isfinite(slow) & (lag > LAG_SECONDS_MIN), np.exp(-scaling * slow), 1.0)
    return np.clip(lag * factor, bins.lag_min, bins.lag_max)


def agreement(left: Floats, came: Floats, p: Persistence) -> Floats:
    """Likelihood ratio (M,) of two slownesses being one object's; 1 where one is unknown."""
    if p.correlation <= 0:
        return np.ones(len(left))
    u, v, r = left / p.sd, came / p.sd, p.correlation
    exponent = (2.0 * r * u * v - r * r * (u * u + v * v)) / (2.0 * (1.0 - r * r))
    ratio: Floats = np.exp(np.minimum(exponent, np.log(AGREEMENT_MAX))) / np.sqrt(1.0 - r * r)
    return np.where(np.isfinite(ratio), np.minimum(ratio, AGREEMENT_MAX), 1.0)
