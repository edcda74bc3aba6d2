"""How often something arrives at one place so and so long after something left another: a coarse look, far and wide.

The joint fit looks for transit times within minutes and believes the clocks. This looks at lags of up to a quarter of
an hour either way, in bins of a second, for which counting is enough: with few events difference by difference, with
many by Fourier transform. Counts are integers, so both ways give the same.
"""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Counts = NDArray[np.float32]

LAGS = 1000
"""Lags are looked at up to this many bins either way."""
BLOCK = 2048
"""Bins of one Fourier block; arrivals are taken from half a block before to half a block after it."""
SPECTRA_MAX = 4096
"""At most this many blocks over all labels (32 MB a thousand); beyond, the newest stretch of time is looked at."""
DIFFERENCES_MAX = 4_000_000
"""Up to this many differences are counted one by one."""
ROWS_AT_ONCE = 256
CHANCE_BINS = (301, 101)
"""Chance is the mean over this many bins around, taken twice: local, so that a common rhythm is part of it."""
CHANCE_MIN = 0.02
SCALES_BINS = (1.5, 4.0, 10.0)
"""Peaks are looked for at these widths, as some transit times are kept closely, others not."""
NOISE_SD = 2.5
"""What is below this many standard deviations of chance counts as nothing."""
HIGHEST_LAGS, HIGHEST_WIDTH = 400, 5
"""Bins either way that the quick look has, and width of its peaks."""
NEAR_BINS = 100.0
"""Longer lags than this are the less likely the longer they are."""


def correlograms(
    left: tuple[Floats, Ints], came: tuple[Floats, Ints], labels: int, source: Ints, target: Ints, bin_seconds: float
) -> Counts:
    """Arrivals at ``target`` (P,) around departures from ``source`` (P,) by lag, (P, 2 LAGS + 1).

    ``left``, ``came``: times (n,) ascending in seconds, and labels (zones or cameras) below ``labels``, not empty.
    """
    blocks = max(SPECTRA_MAX // labels, 1)
    last = max(left[0][-1], came[0][-1])
    first = max(min(left[0][0], came[0][0]), last - blocks * BLOCK * bin_seconds)
    bins, names = [], []
    for t, label in (left, came):
        kept = slice(int(np.searchsorted(t, first)), None)
        bins.append(((t[kept] - first) / bin_seconds).astype(np.int64))
        names.append(label[kept])
    low = np.searchsorted(bins[1], bins[0] - LAGS, side="left")
    high = np.searchsorted(bins[1], bins[0] + LAGS, side="right")
    if int((high - low).sum()) <= DIFFERENCES_MAX:
        return _by_difference(bins, names, labels, source, target, low, high - low)
    return _by_transform(bins, names, labels, source, target)


def _by_difference(
    bins: list[NDArray[np.int64]], names: list[Ints], labels: int, source: Ints, target: Ints,
    low: NDArray[np.intp], n: NDArray[np.intp],
) -> Counts:  # fmt: skip
    row = np.full((labels, labels), -1, np.int32)
    row[source, target] = np.arange(len(source), dtype=np.int32)
    leaving = np.repeat(np.arange(len(n)), n)
    coming = np.arange(len(leaving)) + np.repeat(low - (np.cumsum(n) - n), n)
    pair = row[names[0][leaving], names[1][coming]].astype(np.int64)
    lag = bins[1][coming] - bins[0][leaving] + LAGS
    size = 2 * LAGS + 1
    counts = np.bincount((pair * size + lag)[pair >= 0], minlength=len(source) * size)
    return counts.reshape(len(source), size).astype(np.float32)


def _by_transform(bins: list[NDArray[np.int64]], names: list[Ints], labels: int, source: Ints, target: Ints) -> Counts:
    blocks = int(max(b.max(initial=0) for b in bins)) // BLOCK + 1
    leaving, coming = np.zeros((2, labels, blocks, 2 * BLOCK), np.float32)
    block, at = np.divmod(bins[0], BLOCK)
    np.add.at(leaving, (names[0], block, at + BLOCK // 2), 1.0)
    for shift in (-1, 0, 1):
        block = bins[1] // BLOCK + shift
        at = bins[1] - block * BLOCK + BLOCK // 2
        inside = (block >= 0) & (block < blocks) & (at >= 0) & (at < 2 * BLOCK)
        np.add.at(coming, (names[1][inside], block[inside], at[inside]), 1.0)
    leaving, coming = np.conj(scipy.fft.rfft(leaving)), scipy.fft.rfft(coming)
    counts = np.empty((len(source), 2 * LAGS + 1), np.float32)
    for k in range(0, len(source), ROWS_AT_ONCE):
        rows = slice(k, k + ROWS_AT_ONCE)
        product = np.einsum("pbf,pbf->pf", leaving[source[rows]], coming[target[rows]])
        lags = scipy.fft.irfft(product, 2 * BLOCK)
        counts[rows] = np.rint(np.concatenate((lags[:, -LAGS:], lags[:, : LAGS + 1]), axis=1))
    return counts


def chance(counts: Counts) -> Counts:
    """What each bin of the correlograms (P, lags) would have if there were nothing but local rates."""
    smooth = counts
    for width in CHANCE_BINS:
        smooth = uniform_filter1d(smooth, width, axis=1, mode="nearest")
    result: Counts = np.maximum(smooth, np.float32(CHANCE_MIN))
    return result


def standing_out(counts: Counts, usual: Counts) -> Counts:
    """What stands out of chance in the correlograms (P, lags), in its standard deviations; most of it is zero."""
    above = (counts - usual) / np.sqrt(usual)
    best: Counts = np.zeros_like(above)
    for sd_bins in SCALES_BINS:
        spread = gaussian_filter1d(above, sd_bins, axis=1, mode="constant", truncate=3.0)
        np.maximum(best, spread - NOISE_SD / np.sqrt(2.0 * np.sqrt(np.pi) * sd_bins), out=best)
    near = 1.0 / np.sqrt(1.0 + (np.arange(-LAGS, LAGS + 1) / NEAR_BINS) ** 2)
    best *= near.astype(np.float32)
    return best


def highest(counts: Counts) -> Floats:
    """How far the highest peak stands out of chance in each correlogram (P, lags), (P,): quick, and at one width."""
    peaks = []
    for k in range(0, len(counts), ROWS_AT_ONCE):
        rows = counts[k : k + ROWS_AT_ONCE, LAGS - HIGHEST_LAGS : LAGS + HIGHEST_LAGS + 1]
        usual = chance(rows)
        above = uniform_filter1d(rows - usual, HIGHEST_WIDTH, axis=1, mode="constant") / np.sqrt(usual)
        peaks.append(above.max(axis=1).astype(np.float64))
    return np.concatenate(peaks) if peaks else np.zeros(0)
