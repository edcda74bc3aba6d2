"""Slowness of objects, and how far it persists from one view to the next.

The *slowness* of a passage is the natural log of its dwell time over the median dwell time of
passages with the same zones of entry and exit; nan if unknown. Speed varies more between objects
than along the path of one object, so a slow passage through one view predicts a long transit time
to the next view and a slow passage there. How strongly, the `Persistence`, is estimated from the
transitions of the site that are most certain. Only the significant part of the estimate is used:
where tracks are missing or speeds do not persist, slowness has no effect.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Ints, Longs, Rows
from camtopod.topology import DWELL_SECONDS_MIN, LAG_SECONDS_MIN, MULTIPLIER_MAX, SLOWNESS_MAX

USUAL_PASSAGES_MIN = 5
"""Least number of passages between two zones for their median dwell time to count as usual."""
SURE_RESPONSIBILITY = 0.5
"""Responsibility above which a candidate counts as a transition in the estimate of persistence."""
SURE_TRANSITIONS_MIN = 30
"""Least number of transitions for an estimate of persistence, and least degrees of freedom of the
slope in `_scaling`.
"""
SIGNIFICANT_SD = 2.0
"""Standard errors subtracted from each estimate, so that only a significant one has an effect."""


class Persistence(NamedTuple):
    """How far the speed of an object persists from one view to the next.

    scaling: slope of the log lag on slowness; the lag of an object is proportional to
        exp(scaling * slowness).
    correlation: correlation of the slownesses of one object in two successive views.
    sd: standard deviation of slowness over objects.
    label: share of the objects whose label persists (`labels`).
    """

    scaling: float
    correlation: float
    sd: float
    label: float = 0.0


NO_PERSISTENCE = Persistence(0.0, 0.0, 1.0)
"""Persistence of 0: slowness in one view predicts neither the lag to the next view nor the slowness
there.
"""


def usual_dwell_times(
    source: Ints, target: Ints, dwell: Floats, zones: int
) -> tuple[Longs, Rows, Floats]:
    """Return the usual dwell times of n passages, by pair of zones of entry and exit.

    source, target (n,): zones of entry and exit, from 0 to ``zones`` - 1.
    dwell (n, seconds): dwell times.

    Return the pairs (k,) as source * zones + target, the number of each passage's pair (n,), and
    the median natural log of the dwell times of each pair (k,); nan with less than
    `USUAL_PASSAGES_MIN` passages. Dwell times below `DWELL_SECONDS_MIN` count as that.
    """
    log_dwell = np.log(np.maximum(dwell, DWELL_SECONDS_MIN))
    pairs, number, count = np.unique(
        source.astype(np.int64) * zones + target, return_inverse=True, return_counts=True
    )
    ascending = log_dwell[np.lexsort((log_dwell, number))]
    first = np.cumsum(count) - count
    median = 0.5 * (ascending[first + (count - 1) // 2] + ascending[first + count // 2])
    return pairs, number, np.where(count >= USUAL_PASSAGES_MIN, median, np.nan)


def slowness(source: Ints, target: Ints, dwell: Floats, zones: int) -> Floats:
    """Return the slowness (n,) of passages; nan if too few have the same zones of entry and exit.

    Arguments are as for `usual_dwell_times`.
    """
    _, number, usual = usual_dwell_times(source, target, dwell, zones)
    log_dwell = np.log(np.maximum(dwell, DWELL_SECONDS_MIN))
    return np.clip(log_dwell - usual[number], -SLOWNESS_MAX, SLOWNESS_MAX)


def estimate_persistence(
    before: Floats, after: Floats, lag: Floats, pair: NDArray[np.int32], responsibility: Floats
) -> Persistence:
    """Estimate how far speed persists, from the most certain of M candidates.

    before (M,): slowness of the passage that ends with each candidate's departure; nan if unknown.
    after (M,): slowness of the passage that begins with its arrival; nan if unknown.
    lag (M, seconds): from the departure to the arrival.
    pair (M,): index of the pair of zones.
    responsibility (M,): probability that departure and arrival are of one object.
    """
    # Transitions of which both slownesses are known.
    sure = responsibility > SURE_RESPONSIBILITY
    has_both = sure & np.isfinite(before) & np.isfinite(after)
    n = int(has_both.sum())
    if n < SURE_TRANSITIONS_MIN:
        return NO_PERSISTENCE
    sd = float(np.sqrt(np.mean(np.concatenate((before[has_both] ** 2, after[has_both] ** 2)))))

    # Correlation, less its uncertainty; 0 if all passages take equally long, as those of machines.
    varies = min(before[has_both].std(), after[has_both].std()) > 0
    sample_correlation = (
        float(np.corrcoef(before[has_both], after[has_both])[0, 1]) if varies else 0.0
    )
    correlation = min(max(sample_correlation - SIGNIFICANT_SD / math.sqrt(n), 0.0), 0.95)
    return Persistence(
        _scaling(mean_slowness(before, after), lag, pair, sure), correlation, max(sd, 0.05)
    )


def _scaling(slow: Floats, lag: Floats, pair: NDArray[np.int32], sure: NDArray[np.bool_]) -> float:
    """Estimate the slope of the log lag on slowness within pairs of zones.

    slow (M,): mean slowness of each candidate's two passages; nan if unknown.
    lag, pair (M,): as for `estimate_persistence`.
    sure (M,): mask of the candidates that count as transitions.

    `SIGNIFICANT_SD` standard errors are subtracted; the result is 0 if nothing is left.
    """
    # Slowness (x) and log lag (y) of transitions, less the means of their pair of zones.
    rows = np.flatnonzero(sure & np.isfinite(slow) & (lag > LAG_SECONDS_MIN))
    if len(rows) < SURE_TRANSITIONS_MIN:
        return 0.0
    group = np.unique(pair[rows], return_inverse=True)[1]
    size = np.bincount(group)
    x = slow[rows]
    y = np.log(lag[rows])
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


def mean_slowness(before: Floats, after: Floats) -> Floats:
    """Return the mean (M,) of the slownesses before and after a transition.

    If only one of the two is known, return that; if none is, nan.

    before, after (M,): as for `estimate_persistence`.
    """
    mean = 0.5 * (before + after)
    return np.where(np.isfinite(mean), mean, np.where(np.isfinite(before), before, after))


def adjusted_lag(lag: Floats, slow: Floats, scaling: float) -> Floats:
    """Return the lags (M, seconds) that candidates would have if their objects had usual speed.

    lag (M, seconds): lag of each candidate.
    slow (M,): slowness of each candidate; nan if unknown.
    scaling: as in `Persistence`.

    Lags up to `LAG_SECONDS_MIN` and lags of unknown slowness are not scaled.
    """
    factor = np.where(np.isfinite(slow) & (lag > LAG_SECONDS_MIN), np.exp(-scaling * slow), 1.0)
    result: Floats = lag * factor
    return result


def agreement(before: Floats, after: Floats, p: Persistence) -> Floats:
    """Return the likelihood ratio (M,) of one object over two, by the slownesses of two passages.

    before, after (M,): as for `estimate_persistence`. If either is unknown, the ratio is 1.
    """
    u = before / p.sd
    v = after / p.sd
    r = p.correlation
    exponent = (2.0 * r * u * v - r * r * (u * u + v * v)) / (2.0 * (1.0 - r * r))
    ratio: Floats = np.exp(np.minimum(exponent, np.log(MULTIPLIER_MAX))) / np.sqrt(1.0 - r * r)
    return np.where(np.isfinite(ratio), np.minimum(ratio, MULTIPLIER_MAX), 1.0)
