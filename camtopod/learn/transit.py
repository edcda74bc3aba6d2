"""Transit times of the links: the histogram's peak (thesis 4.5), mean, spread and quantiles.

The thesis takes the most popular bin of the histogram. Bins here are wider for longer lags, so the peak is that of the
density per second, on a smoothed histogram, placed between bins by a parabola through the three highest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.lags import LagBins

Floats = NDArray[np.float64]
QUANTILES = (0.1, 0.5, 0.9)
WEIGHT_MIN = 1e-3
"""Transitions less likely than this do not count for the quantiles."""


class TransitFigures(NamedTuple):
    """Per pair (P,), seconds; nan where there are no transitions."""

    total: Floats
    mode: Floats
    mean: Floats
    sd: Floats
    quantiles: Floats
    """(P, 3): q10, q50, q90."""
    ahead: Floats
    """Share of the transitions with a negative lag: the object was seen there before it left here."""


def transit_figures(
    pair: NDArray[np.int32], lag: Floats, weight: Floats, density: Floats, bins: LagBins
) -> TransitFigures:
    """Figures per pair from weighted lags (M,), and the peak of ``density`` (P, bins) per second."""
    pairs = len(density)
    total: Floats = np.bincount(pair, weight, minlength=pairs).astype(float)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(pair, weight * lag, minlength=pairs) / total
        variance = np.bincount(pair, weight * (lag - mean[pair]) ** 2, minlength=pairs) / total
        ahead = np.bincount(pair, weight * (lag < 0), minlength=pairs) / total
    quantiles = weighted_quantiles(pair, lag, weight, pairs)
    return TransitFigures(total, peak(density, bins), mean, np.sqrt(variance), quantiles, ahead)


def weighted_quantiles(pair: NDArray[np.int32], lag: Floats, weight: Floats, pairs: int) -> Floats:
    """q10, q50, q90 of the lags of each pair, (P, 3): the first lag at which the share of the weight is reached."""
    kept = weight > WEIGHT_MIN
    pair, lag, weight = pair[kept], lag[kept], weight[kept]
    if len(pair) == 0:
        return np.full((pairs, len(QUANTILES)), np.nan)
    order = np.lexsort((lag, pair))
    pair, lag, reached = pair[order], lag[order], np.cumsum(weight[order])
    result = np.full((pairs, len(QUANTILES)), np.nan)
    present, first = np.unique(pair, return_index=True)
    last = np.append(first[1:], len(pair)) - 1
    before = np.where(first > 0, reached[first - 1], 0.0)
    for k, q in enumerate(QUANTILES):
        at = np.searchsorted(reached, before + q * (reached[last] - before), side="left")
        result[present, k] = lag[np.clip(at, first, last)]
    return result


def peak(density: Floats, bins: LagBins) -> Floats:
    """Lag (seconds) at the peak of each row of ``density`` (P, bins); nan for an empty row."""
    rows = np.arange(len(density))
    top = np.argmax(density, axis=1) if density.size else np.zeros(0, int)
    padded = np.pad(density, ((0, 0), (1, 1)))
    left, here, right = padded[rows, top], padded[rows, top + 1], padded[rows, top + 2]
    curve = left - 2.0 * here + right
    shift = np.where(curve < 0, 0.5 * (left - right) / np.where(curve < 0, curve, -1.0), 0.0)
    at = bins.scale * np.sinh(bins.step * (bins.first + top + 0.5 + np.clip(shift, -0.5, 0.5)))
    return np.where(here > 0, at, np.nan)
