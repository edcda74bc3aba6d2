"""Transit times of the links: the histogram's peak (thesis 4.5), mean, spread and quantiles, and
how sure they are.

The thesis takes the most popular bin of the histogram. Bins here are wider for longer lags, so the
peak is that of the density per second, on a smoothed histogram, placed between bins by a parabola
through the three highest.

The median rests on two estimates, each counting as it is sure. One is the median of the lags. The
other is that of the lags as objects of usual speed would have had them: speeds vary far more
between objects than within one, and how fast an object was is known from the views it came from and
went to, where many more have been seen than on this way.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats
from camtopod.topology import LagBins

QUANTILES = (0.1, 0.5, 0.9)
QUARTILES = (0.25, 0.5, 0.75)
WEIGHT_MIN = 1e-3
"""Transitions less likely than this do not count for the quantiles, where there are others."""
NORMAL_QUARTILES = 1.349
"""Distance of the quartiles of a normal distribution, in standard deviations."""
MEDIAN_ERROR = 1.2533
"""Standard error of the median of n normal values over sd / sqrt(n)."""
FAR_SD = 4.5
"""Lags further from the median than this are chance and do not count for mean and sd."""
SPREAD_MIN_SECONDS = 0.2
"""Entries and exits are not seen more exactly than this."""
LAG_ERROR = 0.01
PACE_ERROR = 0.02
MEAN_ERROR = 0.015
"""What does not become surer with numbers (false transitions, speeds that are only nearly kept), as
a share: of the median of the lags as they are, of the median of those at usual speed, of the mean.
Found on made-up networks.
"""
ERRORS_CORRELATION = 0.7
"""Of the two estimates, which are from the same transitions."""


class TransitFigures(NamedTuple):
    """Per pair (P,), seconds; nan where there are no transitions."""

    total: Floats
    mode: Floats
    mean: Floats
    sd: Floats
    quantiles: Floats
    """(P, 3): q10, q50, q90."""
    ahead: Floats
    """Share of the transitions with a negative lag: the object was seen there before it left
    here.
    """
    median_error: Floats
    """Standard error of the median."""
    mean_error: Floats


def transit_figures(
    pair: NDArray[np.int32],
    lag: Floats,
    weight: Floats,
    density: Floats,
    bins: LagBins,
    slow: Floats | None = None,
    slow_error: Floats | None = None,
) -> TransitFigures:
    """Figures per pair from weighted lags (M,), and the peak of ``density`` (P, bins) per second.

    ``slow`` (M,): by what power of e the object was slower than usual; nan: unknown. ``slow_error``
    (P,): the standard error of what is usual.
    """
    pairs = len(density)
    total: Floats = np.bincount(pair, weight, minlength=pairs).astype(float)
    quantiles, quartiles = np.hsplit(
        weighted_quantiles(pair, lag, weight, pairs, QUANTILES + QUARTILES), 2
    )
    median, error, spread = _median(quartiles, total)
    near = np.abs(lag - median[pair]) <= FAR_SD * spread[pair]
    with np.errstate(invalid="ignore", divide="ignore"):
        ahead = np.bincount(pair, weight * (lag < 0), minlength=pairs) / total
        inner = np.where(near, weight, 0.0)
        number = np.bincount(pair, inner, minlength=pairs)
        mean = np.bincount(pair, inner * lag, minlength=pairs) / number
        sd = np.sqrt(np.bincount(pair, inner * (lag - mean[pair]) ** 2, minlength=pairs) / number)
        sure = np.bincount(pair, inner * weight, minlength=pairs)
        few = np.sqrt(number / np.maximum(number - 1.0, 0.5))
        mean_error = np.hypot(
            np.maximum(sd, SPREAD_MIN_SECONDS) * few / np.sqrt(sure), MEAN_ERROR * mean
        )
        error = np.hypot(error, LAG_ERROR * median)
        if slow is not None and slow_error is not None:
            usual = np.isfinite(slow)
            known = np.bincount(pair[usual], weight[usual], minlength=pairs).astype(float)
            at_usual = lag[usual] * np.exp(-slow[usual])
            at_quartiles = weighted_quantiles(
                pair[usual], at_usual, weight[usual], pairs, QUARTILES
            )
            other, other_error, _ = _median(at_quartiles, known)
            other_error = np.hypot(other_error, np.hypot(slow_error, PACE_ERROR) * other)
            both, error = _weighed(median, error, other, other_error)
            quantiles = quantiles + (both - median)[:, None]
    return TransitFigures(total, peak(density, bins), mean, sd, quantiles, ahead, error, mean_error)


def _median(quartiles: Floats, total: Floats) -> tuple[Floats, Floats, Floats]:
    """Median, its standard error and the spread (as an sd) of the lags of each pair, (P,) each."""
    low, middle, high = quartiles.T
    spread = np.maximum((high - low) / NORMAL_QUARTILES, SPREAD_MIN_SECONDS)
    return middle, MEDIAN_ERROR * spread / np.sqrt(total), spread


def _weighed(
    one: Floats, one_error: Floats, other: Floats, other_error: Floats
) -> tuple[Floats, Floats]:
    """Mean (P,) of two estimates, the surer counting more, and its standard error; the first where
    it is alone.
    """
    share = one_error**2 / (one_error**2 + other_error**2)
    a, b = (1.0 - share) * one_error, share * other_error
    error = np.sqrt(a * a + b * b + 2.0 * ERRORS_CORRELATION * a * b)
    there = np.isfinite(share)
    return np.where(there, one + share * (other - one), one), np.where(there, error, one_error)


def weighted_quantiles(
    pair: NDArray[np.int32],
    lag: Floats,
    weight: Floats,
    pairs: int,
    shares: tuple[float, ...] = QUANTILES,
) -> Floats:
    """Quantiles of the lags of each pair, (P, shares): the first lag at which the share of the
    weight is reached.
    """
    likely = weight > WEIGHT_MIN
    some_likely = np.bincount(pair[likely], minlength=pairs) > 0
    kept = likely | ((weight > 0.0) & ~some_likely[pair])
    pair, lag, weight = pair[kept], lag[kept], weight[kept]
    if len(pair) == 0:
        return np.full((pairs, len(shares)), np.nan)
    order = np.lexsort((lag, pair))
    pair, lag, reached = pair[order], lag[order], np.cumsum(weight[order])
    result = np.full((pairs, len(shares)), np.nan)
    present, first = np.unique(pair, return_index=True)
    last = np.append(first[1:], len(pair)) - 1
    before = np.where(first > 0, reached[first - 1], 0.0)
    for k, q in enumerate(shares):
        at = np.searchsorted(reached, before + q * (reached[last] - before), side="left")
        result[present, k] = lag[np.clip(at, first, last)]
    return result


def peak(density: Floats, bins: LagBins) -> Floats:
    """Lag (seconds) at the peak of each row of ``density`` (P, bins); nan for an empty row."""
    rows = np.arange(len(density))
    top = np.argmax(density, axis=1) if density.size else np.zeros(0, int)
    last = density.shape[1] - 1
    here = density[rows, top]
    left = np.where(top > 0, density[rows, np.maximum(top - 1, 0)], 0.0)
    right = np.where(top < last, density[rows, np.minimum(top + 1, last)], 0.0)
    curve = left - 2.0 * here + right
    shift = np.where(curve < 0, 0.5 * (left - right) / np.where(curve < 0, curve, -1.0), 0.0)
    at = bins.scale * np.sinh(bins.step * (bins.first + top + 0.5 + np.clip(shift, -0.5, 0.5)))
    return np.where(here > 0, at, np.nan)
