"""Correlograms: number of arrivals at one zone by their lag after departures from another.

Zones are given by numbers, the *labels*; cameras may take the place of zones. The correlogram of a
pair (source, target) has `LAGS` bins either way: bin k holds the number of pairs of a departure
from the source and an arrival at the target that comes k bins later. Related zones show as a peak
above the null model, `null_expectation`. The joint fit estimates transit times of up to a few
minutes and needs correct clocks. A correlogram only counts, so it reaches much further: about a
quarter of an hour with bins of a second, negative lags included.

`Correlograms` counts by Fourier transform and rounds to integers.
"""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from camtopod.arrays import Floats, Ints, rows_by_group

Counts = NDArray[np.float32]
Spectra = NDArray[np.complex64]

LAGS = 1000
"""Largest lag, in bins, either way."""
SPECTRA_MAX = 4096
"""Limit of the blocks of all labels together; beyond, only the newest stretch of time counts. A
block are the departures in twice `LAGS` bins, with arrivals from `LAGS` before to `LAGS` after it.

Half as many transforms are kept in memory, departures and arrivals together (16 MB a thousand).
Others are computed again when they are needed.
"""
ROWS_AT_ONCE = 256
"""Number of correlograms that callers ask for at a time."""
CHANCE_BINS = 301
"""Width, in bins, of the moving average that makes the null model of a correlogram. The average is
local, so that a rhythm common to all zones is part of the null model.
"""
PEAK_BINS = 3.0
"""Standard deviation, in bins, of the smoothing of correlograms in which peaks are looked for."""
NOISE_SD = 2.5
"""Standard deviations of the null model subtracted from every peak; lower peaks count as none."""
NEAR_BINS = 100.0
"""Lag in bins beyond which a peak weighs less, the less the longer its lag is."""


class Correlograms:
    """The correlograms of departures and arrivals, by Fourier transform.

    departures: times (n,) in seconds, ascending, and labels (n,); not empty.
    arrivals: times (m,) and labels (m,), likewise.
    labels: number of labels; they are counted from 0.
    bin_seconds: width of the bins, usually `BIN_SECONDS`.

    It is fastest if pairs asked for in succession have at most ``at_once`` labels
    (`cache_friendly_order`).
    """

    def __init__(
        self,
        departures: tuple[Floats, Ints],
        arrivals: tuple[Floats, Ints],
        labels: int,
        bin_seconds: float,
    ) -> None:
        # Bin the newest stretch of time.
        blocks = max(SPECTRA_MAX // labels, 1)
        last = max(departures[0][-1], arrivals[0][-1])
        first = max(min(departures[0][0], arrivals[0][0]), last - blocks * 2 * LAGS * bin_seconds)
        self._blocks = int((last - first) / bin_seconds) // (2 * LAGS) + 1
        self._bins = []
        for t, label in (departures, arrivals):
            part = slice(int(np.searchsorted(t, first)), None)
            bins = ((t[part] - first) / bin_seconds).astype(np.int64)
            self._bins.append([bins[rows] for rows in rows_by_group(label[part], labels)])
        self.at_once = max(SPECTRA_MAX // (4 * self._blocks), 2)
        """Number of labels whose transforms are kept."""
        self._spectra: dict[tuple[int, int], Spectra] = {}
        """Transforms by (side, label), those used last at the end."""

    def between(self, source: Ints, target: Ints) -> Counts:
        """Return the correlograms (P, 2 LAGS + 1) of P pairs of labels, from lag -LAGS to LAGS.

        source, target (P,): labels of the departures and of the arrivals.
        """
        product = np.empty((len(source), 2 * LAGS + 1), np.complex64)
        for row, u, v in zip(product, source.tolist(), target.tolist(), strict=True):
            np.sum(self._of_label(0, u) * self._of_label(1, v), axis=0, out=row)
        lags = scipy.fft.irfft(product, 4 * LAGS)
        counts: Counts = np.rint(np.concatenate((lags[:, -LAGS:], lags[:, : LAGS + 1]), axis=1))
        return counts

    def _of_label(self, side: int, label: int) -> Spectra:
        """Return the Fourier transforms (blocks, frequencies) of the events of one label.

        side: 0 for departures in each block, conjugate; 1 for arrivals from before to after it.
        """
        spectra = self._spectra.pop((side, label), None)
        if spectra is None:
            # Count the events by block and bin.
            bins = self._bins[side][label]
            block = bins // (2 * LAGS) + np.array(((0,), (-1, 0, 1))[side])[:, None]
            at = bins - block * 2 * LAGS + LAGS
            inside = (block >= 0) & (block < self._blocks) & (at >= 0) & (at < 4 * LAGS)
            cell = block[inside] * 4 * LAGS + at[inside]
            present = np.bincount(cell, minlength=self._blocks * 4 * LAGS).astype(np.float32)

            # Transform.
            spectra = scipy.fft.rfft(present.reshape(self._blocks, -1), overwrite_x=True)
            if side == 0:
                np.conj(spectra, out=spectra)

        # Keep the transforms used last.
        self._spectra[side, label] = spectra
        if len(self._spectra) > 2 * self.at_once:
            del self._spectra[next(iter(self._spectra))]
        return spectra


def cache_friendly_order(a: Ints, b: Ints, at_once: int) -> NDArray[np.intp]:
    """Return an order (P,) of pairs in which pairs of the same labels are close together.

    a, b (P,): the two labels of each pair.
    at_once: number of labels whose transforms are kept.

    The order passes through the matrix of all pairs tile by tile.
    """
    side = max(at_once // 2, 1)
    return np.lexsort((b, a, b // side, a // side))


def null_expectation(counts: Counts) -> Counts:
    """Return the expectation of correlograms under the null model, (P, lags).

    counts (P, lags): the correlograms, from which the null model is computed by a moving average
        (at least that of one count).
    """
    smooth = uniform_filter1d(counts, CHANCE_BINS, axis=1, mode="nearest")
    result: Counts = np.maximum(smooth, np.float32(1.0 / CHANCE_BINS))
    return result


def significant_peaks(counts: Counts, usual: Counts) -> Counts:
    """Return the height of the peaks of correlograms at each lag (P, lags); 0 where there is none.

    counts, usual (P, lags): correlograms, and their expectations (`null_expectation`).

    Heights are in standard deviations of the null model, of which `NOISE_SD` are subtracted. Lags
    longer than `NEAR_BINS` weigh less.
    """
    above = (counts - usual) / np.sqrt(usual)
    smooth = gaussian_filter1d(above, PEAK_BINS, axis=1, mode="constant", truncate=3.0)
    noise = np.float32(NOISE_SD / np.sqrt(2.0 * np.sqrt(np.pi) * PEAK_BINS))
    near = 1.0 / np.sqrt(1.0 + (np.arange(-LAGS, LAGS + 1) / NEAR_BINS) ** 2)
    peaks: Counts = np.maximum(smooth - noise, np.float32(0.0)) * near.astype(np.float32)
    return peaks
