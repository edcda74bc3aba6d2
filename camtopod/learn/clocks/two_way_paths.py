"""Two-way paths: paths that objects take in both directions, which show a difference of two clocks.

If a path takes as long from zone u to zone v as back, the lags from u to v appear longer by the
offset of v's clock relative to u's clock, and the lags from v to u shorter by the same. So the
correlogram of one direction (number of arrivals by lag, see `correlogram`) is that of the other
direction shifted by twice the offset. This holds for unseen paths, overlapping views and paths
through the views of other cameras alike.

`find_two_way_paths` first finds the shift that all pairs of zones of two cameras have in common
(`best_shift`), then refines the peaks of each pair of zones at this shift. All lags and shifts are
in bins of the correlograms.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.fft
from scipy import ndimage

from camtopod.arrays import Floats
from camtopod.learn.clocks.correlogram import (
    LAGS,
    PEAK_BINS,
    Counts,
    null_expectation,
    significant_peaks,
)

PEAK_MIN = 3.0
"""Least match, as defined at `best_shift`, that the best shift must have."""
PEAK_WIDTH_BINS = 60
"""Half the width of the peak of the match around the best shift, in bins; and largest width
(standard deviation) of the window around a peak.
"""
RUNNER_UP_MAX = 0.2
"""Largest match of any shift outside the peak of the best shift, as a share of the best match."""
SHARE_MIN = 0.02
"""Least match of a pair of zones at the best shift, as a share of the best match."""
ROUNDS = 12
"""Iterations of the mean shift, and of robust least squares."""
EVENTS_MIN = 8.0
"""Least events above the null model within the window, in each direction."""


class TwoWayPath(NamedTuple):
    """A path taken in both directions, between a zone of a first and one of a second camera.

    All values are in bins.

    ahead: offset of the second camera's clock relative to the first one's, positive if fast.
    sd: standard deviation of ``ahead``.
    transit: mean transit time, free of the offset.
    spread: standard deviation of transit times.
    """

    ahead: float
    sd: float
    transit: float
    spread: float


def best_shift(forth: Counts, back: Counts) -> tuple[int, float]:
    """Return the shift, in bins, at which the peaks of both directions match best, and the match.

    forth, back (K, lags): peaks of the correlograms of K pairs of zones (`significant_peaks`), from
        the first camera to the second and back.

    The shift is positive if lags are longer in ``forth``. The match is the sum, over pairs of zones
    and lags, of the products of the peaks; 0.0 if it is too small or not clearly larger than that
    of every other shift.
    """
    # Match of every shift, summed over the pairs of zones.
    length = scipy.fft.next_fast_len(4 * LAGS + 1, real=True)
    product = scipy.fft.rfft(forth, length) * np.conj(scipy.fft.rfft(back, length))
    match = scipy.fft.irfft(product.sum(axis=0), length).astype(np.float64)
    match = ndimage.gaussian_filter1d(
        np.concatenate((match[-2 * LAGS :], match[: 2 * LAGS + 1])), PEAK_BINS
    )

    # The best shift must be clearly better than those outside its peak.
    at = int(np.argmax(match))
    peak = float(match[at])
    match[max(at - PEAK_WIDTH_BINS, 0) : at + PEAK_WIDTH_BINS + 1] = 0.0
    clear = peak >= PEAK_MIN and float(match.max()) <= RUNNER_UP_MAX * peak
    return at - 2 * LAGS, peak if clear else 0.0


def find_two_way_paths(forth: Counts, back: Counts) -> list[TwoWayPath]:
    """Find the two-way paths between two cameras.

    forth, back (K, lags): correlograms of K pairs of zones, from the first camera to the second and
        back.
    """
    # The shift that all pairs of zones of the two cameras have in common.
    usual = null_expectation(forth), null_expectation(back)
    clear = significant_peaks(forth, usual[0]), significant_peaks(back, usual[1])
    shift, peak = best_shift(*clear)
    if peak <= 0.0:
        return []

    # Peaks that both directions have at this shift.
    first_way = ndimage.shift(clear[0], (0, -shift), order=0)
    together = ndimage.gaussian_filter1d(first_way * clear[1], PEAK_BINS, axis=1, mode="constant")

    # Refine those of each pair of zones that are high enough.
    paths = [
        _refine(
            np.stack((forth[k], back[k])),
            np.stack((usual[0][k], usual[1][k])),
            np.argmax(together[k]) - LAGS + np.array((shift, 0.0)),
        )
        for k in np.flatnonzero(together.max(axis=1) >= SHARE_MIN * peak)
    ]
    return [path for path in paths if path is not None]


def _refine(counts: Counts, usual: Counts, lags: Floats) -> TwoWayPath | None:
    """Return the two-way path with peaks near given lags in both directions; None if there is none.

    counts, usual (2, lags): correlogram of one pair of zones in each direction, and its expectation
        under the null model.
    lags (2,): lags of the two peaks, bins.

    The centres of the peaks are found by mean shift in a normal window 1.5 times as wide as the
    peaks.
    """
    lag = np.arange(-LAGS, LAGS + 1)
    centres = lags
    width = PEAK_BINS
    for _ in range(ROUNDS):
        # Number and variance of the events above the null model, and the standard error of the
        # difference of the new centres.
        squares = (lag - centres[:, None]) ** 2
        window = np.exp(-0.5 * squares / width**2)
        above = window * (counts - usual)
        number = above.sum(axis=1)
        if number.min() < EVENTS_MIN:
            return None
        centres = above @ lag / number
        if np.abs(centres - lags).max() > LAGS:
            return None
        error = np.sqrt(np.sum(np.sum(window**2 * counts * squares, axis=1) / number**2))
        within = float(np.sum(above * squares) / number.sum())
        within = min(max(within, 0.0), 0.9 * width**2)

        # The width of a normal peak that the window has made narrower.
        narrowing = 1.0 - within / width**2
        spread = float(np.sqrt(within / narrowing))
        width = float(np.clip(1.5 * spread, PEAK_BINS, PEAK_WIDTH_BINS))

    # Half the difference of the two lags is the offset.
    forth, back = centres.tolist()
    sd = 0.5 * float(error) / narrowing
    return TwoWayPath(0.5 * (forth - back), sd, 0.5 * (forth + back), spread)
