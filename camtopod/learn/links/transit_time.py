"""Transit times of links: mode (thesis 4.5), mean, spread, quantiles and errors (METHOD 8).

`transit_figures` computes them for every pair of zones from possible transitions, each with its lag
and the probability that it is a transition as its weight. Lag bins are wider for longer lags, so
the mode is the peak of the density per second, on a smoothed histogram, placed between bins by a
parabola.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from camtopod.arrays import Floats
from camtopod.learn.association import LIKELY_MIN
from camtopod.learn.traffic import EVENT_SD_SECONDS
from camtopod.topology import LagBins

QUANTILES = (0.1, 0.5, 0.9)
"""Quantiles of the transit time that are published."""
QUARTILES = (0.25, 0.5, 0.75)
"""Quartiles, from which median and spread are estimated."""
NORMAL_QUARTILES = float(np.diff(ndtri((0.25, 0.75)))[0])
"""Distance between the quartiles of a normal distribution, in standard deviations."""
MEDIAN_ERROR = math.sqrt(math.pi / 2.0)
"""Ratio of the standard error of the median of n normal values to sd / sqrt(n)."""
FAR_SD = 4.5
"""Largest distance from the median, in standard deviations, of lags that count for mean and sd.
Lags further away are spurious.
"""
SYSTEMATIC_ERROR = 0.015
"""Relative error of a median or mean that does not shrink with the number of lags. It comes from
spurious transitions. The value was found on simulated networks.
"""


class TransitFigures(NamedTuple):
    """Transit times of P pairs of zones; columns are (P,), in seconds; nan without transitions."""

    total: Floats
    """Expected number of transitions."""
    mode: Floats
    """Peak of the transit density."""
    mean: Floats
    """Mean, without lags far from the median."""
    sd: Floats
    """Standard deviation, without lags far from the median."""
    quantiles: Floats
    """(P, 3) 10 %, 50 % and 90 % quantiles."""
    ahead: Floats
    """Share of the transitions with a negative lag, of objects that are in both views at once."""
    median_error: Floats
    """Standard error of the median."""
    mean_error: Floats
    """Standard error of the mean."""


def transit_figures(
    pair: NDArray[np.int32],
    lag: Floats,
    weight: Floats,
    density: Floats,
    bins: LagBins,
) -> TransitFigures:
    """Return the figures of the transit times of P pairs of zones.

    pair (M,): pair of zones of each possible transition.
    lag (M, seconds): from departure to arrival.
    weight (M,): probability that it is a transition.
    density (P, bins): smoothed density of the lags of each pair, per second, for the mode.
    """
    # Quantiles, the median's standard error, and the spread from the quartiles.
    pairs = len(density)
    total: Floats = np.bincount(pair, weight, minlength=pairs).astype(float)
    quantiles, quartiles = np.hsplit(
        weighted_quantiles(pair, lag, weight, pairs, QUANTILES + QUARTILES), 2
    )
    low, median, high = quartiles.T
    spread = np.maximum((high - low) / NORMAL_QUARTILES, EVENT_SD_SECONDS)

    # Mean and sd of the lags near the median.
    near = np.abs(lag - median[pair]) <= FAR_SD * spread[pair]
    with np.errstate(invalid="ignore", divide="ignore"):
        ahead = np.bincount(pair, weight * (lag < 0), minlength=pairs) / total
        inner = np.where(near, weight, 0.0)
        number = np.bincount(pair, inner, minlength=pairs)
        mean = np.bincount(pair, inner * lag, minlength=pairs) / number
        sd = np.sqrt(np.bincount(pair, inner * (lag - mean[pair]) ** 2, minlength=pairs) / number)

        # Standard errors, with the part that does not shrink.
        sure = np.bincount(pair, inner * weight, minlength=pairs)
        small_sample_factor = np.sqrt(number / np.maximum(number - 1.0, 0.5))
        mean_error = np.hypot(
            np.maximum(sd, EVENT_SD_SECONDS) * small_sample_factor / np.sqrt(sure),
            SYSTEMATIC_ERROR * mean,
        )
        error = np.hypot(MEDIAN_ERROR * spread / np.sqrt(total), SYSTEMATIC_ERROR * median)
    return TransitFigures(total, peak(density, bins), mean, sd, quantiles, ahead, error, mean_error)


def weighted_quantiles(
    pair: NDArray[np.int32],
    lag: Floats,
    weight: Floats,
    pairs: int,
    shares: tuple[float, ...] = QUANTILES,
) -> Floats:
    """Return weighted quantiles of the lags of each pair of zones, (P, number of shares); or nan.

    pair, lag, weight (M,): as for `transit_figures`.
    pairs: number of pairs, P.
    shares: the quantiles, from 0 to 1. A quantile is the first lag at which this share of the
        weight is reached.
    """
    # Leave out improbable transitions, unless a pair has no others.
    likely = weight > LIKELY_MIN
    some_likely = np.bincount(pair[likely], minlength=pairs) > 0
    rows = np.flatnonzero(likely | ((weight > 0.0) & ~some_likely[pair]))
    result = np.full((pairs, len(shares)), np.nan)
    if len(rows) == 0:
        return result

    # Cumulative weights of the lags in order, pair by pair.
    rows = rows[np.lexsort((lag[rows], pair[rows]))]
    pair = pair[rows]
    lag = lag[rows]
    cumulative = np.cumsum(weight[rows])
    present, first = np.unique(pair, return_index=True)
    last = np.append(first[1:], len(pair)) - 1
    before = np.where(first > 0, cumulative[first - 1], 0.0)
    for k, q in enumerate(shares):
        at = np.searchsorted(cumulative, before + q * (cumulative[last] - before), side="left")
        result[present, k] = lag[np.clip(at, first, last)]
    return result


def peak(density: Floats, bins: LagBins) -> Floats:
    """Return the lag (P, seconds) at the peak of each density; nan where it is zero everywhere.

    density (P, bins): per second.
    """
    # The highest bin and its neighbours.
    rows = np.arange(len(density))
    top = np.argmax(density, axis=1)
    last = density.shape[1] - 1
    at_peak = density[rows, top]
    before = np.where(top > 0, density[rows, np.maximum(top - 1, 0)], 0.0)
    after = np.where(top < last, density[rows, np.minimum(top + 1, last)], 0.0)

    # Vertex of the parabola through the three, within half a bin of the highest.
    curve = before - 2.0 * at_peak + after
    shift = np.where(curve < 0, 0.5 * (before - after) / np.where(curve < 0, curve, -1.0), 0.0)
    at = bins.scale * np.sinh(bins.step * (bins.first + top + 0.5 + np.clip(shift, -0.5, 0.5)))
    return np.where(at_peak > 0, at, np.nan)
