"""How often something arrives at one place so and so long after something left another: a coarse
look, far and wide.

The joint fit looks for transit times within minutes and believes the clocks. This looks at lags of
up to a quarter of an hour either way, in bins of a second, for which counting is enough: with few
events difference by difference, with many by Fourier transform. Counts are integers, so both ways
give the same.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from camtopod.arrays import Floats, Ints, Longs, rows_of

Counts = NDArray[np.float32]
Spectra = NDArray[np.complex64]

LAGS = 1000
"""Lags are looked at up to this many bins either way."""
BLOCK = 2048
"""Bins of one Fourier block; arrivals are taken from half a block before to half a block after
it.
"""
SPECTRA_MAX = 4096
"""At most this many blocks over all labels; beyond, the newest stretch of time is looked at."""
SPECTRA_KEPT = 2048
"""Transforms of blocks that are kept, of what left and of what came (16 MB a thousand); others are
made again when they are asked for.
"""
DIFFERENCES_MAX = 4_000_000
"""Up to this many differences are counted one by one."""
DIFFERENCES_AT_ONCE = 500_000
ROWS_AT_ONCE = 256
"""Correlograms that are looked at together."""
CHANCE_BINS = (301, 101)
"""Chance is the mean over this many bins around, taken twice: local, so that a common rhythm is
part of it.
"""
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
    left: tuple[Floats, Ints], came: tuple[Floats, Ints], labels: int, bin_seconds: float
) -> ByDifference | ByTransform:
    """Everything that left and came, ready to be counted by lag, a few pairs at a time: all would
    be a lot of memory. It is quickest where those asked for one after the other have at most
    ``at_once`` labels (`side_by_side`).

    ``left``, ``came``: times (n,) ascending in seconds, and labels (zones or cameras) below
    ``labels``; not empty.
    """
    blocks = max(SPECTRA_MAX // labels, 1)
    last = max(left[0][-1], came[0][-1])
    first = max(min(left[0][0], came[0][0]), last - blocks * BLOCK * bin_seconds)
    bins, names = [], []
    for t, label in (left, came):
        kept = slice(int(np.searchsorted(t, first)), None)
        bins.append(((t[kept] - first) / bin_seconds).astype(np.int64))
        names.append(label[kept].astype(np.int64))
    low = np.searchsorted(bins[1], bins[0] - LAGS, side="left")
    n = np.searchsorted(bins[1], bins[0] + LAGS, side="right") - low
    if int(n.sum()) <= DIFFERENCES_MAX:
        return ByDifference(bins, names, labels, low, n)
    return ByTransform(bins, names, labels)


def side_by_side(a: NDArray[Any], b: NDArray[Any], at_once: int) -> NDArray[np.intp]:
    """An order of pairs (P,) in which those that come one after the other have few labels, for long
    at most ``at_once``: tile by tile of the matrix of all pairs.
    """
    side = max(at_once // 2, 1)
    return np.lexsort((b, a, b // side, a // side))


class ByDifference:
    """Counts difference by difference. ``low``, ``n``: the first arrival within the lags of each
    departure, and how many there are.
    """

    def __init__(
        self, bins: list[Longs], names: list[Longs], labels: int, low: Longs, n: Longs
    ) -> None:
        self._labels = self.at_once = labels
        reached = np.cumsum(n)
        # Each difference as (source, target, lag) in one number.
        self._cells = np.empty(int(n.sum()), np.int64)
        for k in range(0, len(self._cells), DIFFERENCES_AT_ONCE):
            few = slice(*np.searchsorted(reached, (k, k + DIFFERENCES_AT_ONCE), side="right"))
            if few.start == few.stop:  # one departure that has more
                continue
            leaving = np.repeat(np.arange(few.start, few.stop), n[few])
            begun = reached[few] - n[few]
            coming = np.arange(len(leaving)) + np.repeat(low[few] - (begun - begun[0]), n[few])
            pair = names[0].take(leaving) * labels + names[1].take(coming)
            lag = bins[1].take(coming) - bins[0].take(leaving) + LAGS
            self._cells[begun[0] : begun[0] + len(leaving)] = pair * (2 * LAGS + 1) + lag
        self._cells.sort()

    def of(self, source: Ints, target: Ints) -> Counts:
        """Arrivals at ``target`` (P,) around departures from ``source`` (P,) by lag, (P, 2 LAGS +
        1).
        """
        counts = np.zeros((len(source), 2 * LAGS + 1), np.float32)
        first = (source.astype(np.int64) * self._labels + target) * counts.shape[1]
        low, high = (
            np.searchsorted(self._cells, cell) for cell in (first, first + counts.shape[1])
        )
        for k, row in enumerate(counts):
            np.add.at(row, self._cells[low[k] : high[k]] - first[k], 1.0)
        return counts


class ByTransform:
    """Counts by Fourier transform."""

    def __init__(self, bins: list[Longs], names: list[Longs], labels: int) -> None:
        self._blocks = int(max(b.max(initial=0) for b in bins)) // BLOCK + 1
        self._bins = [
            [some[rows] for rows in rows_of(name, labels)]
            for some, name in zip(bins, names, strict=True)
        ]
        self.at_once = max(SPECTRA_KEPT // (2 * self._blocks), 2)
        """Labels of which the transforms are kept."""
        self._spectra: dict[tuple[int, int], Spectra] = {}  # those asked for last

    def of(self, source: Ints, target: Ints) -> Counts:
        """As `ByDifference.of`."""
        product = np.empty((len(source), BLOCK + 1), np.complex64)
        for row, u, v in zip(product, source.tolist(), target.tolist(), strict=True):
            np.einsum("bf,bf->f", self._of_label(0, u), self._of_label(1, v), out=row)
        lags = scipy.fft.irfft(product, 2 * BLOCK)
        counts: Counts = np.rint(np.concatenate((lags[:, -LAGS:], lags[:, : LAGS + 1]), axis=1))
        return counts

    def _of_label(self, side: int, label: int) -> Spectra:
        """(blocks, frequencies) of what left in each block, conjugate (``side`` 0), or of what came
        from half a block before it to half a block after it (1).
        """
        known = self._spectra.pop((side, label), None)
        if known is None:
            bins = self._bins[side][label]
            present = np.zeros((self._blocks, 2 * BLOCK), np.float32)
            for shift in ((0,), (-1, 0, 1))[side]:
                block = bins // BLOCK + shift
                at = bins - block * BLOCK + BLOCK // 2
                inside = (block >= 0) & (block < self._blocks) & (at >= 0) & (at < 2 * BLOCK)
                np.add.at(present, (block[inside], at[inside]), 1.0)
            known = scipy.fft.rfft(present, overwrite_x=True)
            if side == 0:
                np.conj(known, out=known)
        self._spectra[side, label] = known
        if len(self._spectra) > 2 * self.at_once:
            del self._spectra[next(iter(self._spectra))]
        return known


def chance(counts: Counts) -> Counts:
    """What each bin of the correlograms (P, lags) would have if there were nothing but local
    rates.
    """
    smooth = counts
    for width in CHANCE_BINS:
        smooth = uniform_filter1d(smooth, width, axis=1, mode="nearest")
    result: Counts = np.maximum(smooth, np.float32(CHANCE_MIN))
    return result


def standing_out(counts: Counts, usual: Counts) -> Counts:
    """What stands out of chance in the correlograms (P, lags), in its standard deviations; most of
    it is zero.
    """
    above = (counts - usual) / np.sqrt(usual)
    best: Counts = np.zeros_like(above)
    for sd_bins in SCALES_BINS:
        spread = gaussian_filter1d(above, sd_bins, axis=1, mode="constant", truncate=3.0)
        np.maximum(best, spread - NOISE_SD / np.sqrt(2.0 * np.sqrt(np.pi) * sd_bins), out=best)
    near = 1.0 / np.sqrt(1.0 + (np.arange(-LAGS, LAGS + 1) / NEAR_BINS) ** 2)
    best *= near.astype(np.float32)
    return best


def highest(counts: Counts) -> Floats:
    """How far the highest peak stands out of chance in each correlogram (P, lags), (P,): quick, and
    at one width.
    """
    rows = counts[:, LAGS - HIGHEST_LAGS : LAGS + HIGHEST_LAGS + 1]
    usual = chance(rows)
    above = uniform_filter1d(rows - usual, HIGHEST_WIDTH, axis=1, mode="constant") / np.sqrt(usual)
    peaks: Floats = above.max(axis=1).astype(np.float64)
    return peaks
