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
from scipy.ndimage import gaussian_filter1d

from camtopod.arrays import Floats
from camtopod.learn.clocks.correlogram import LAGS, Counts, null_expectation, significant_peaks

SHIFT_SMOOTHING_BINS = 3.0
"""Standard deviation of the smoothing over shifts, bins."""
TRANSFORM = 4 * 1024
"""Length of the Fourier transforms in bins, enough for shifts of up to 2 `LAGS`."""
PEAK_MIN = 3.0
"""Least match, as defined at `best_shift`, that the best shift must have."""
PEAK_WIDTH_BINS = 60
"""Half the width of the peak of the match around the best shift, in bins."""
RUNNER_UP_MAX = 0.2
"""Largest match of any shift outside the peak of the best shift, as a share of the best match."""
SHARE_MIN = 0.02
"""Least match of a pair of zones at the best shift, as a share of the best match."""
WIDTHS_BINS = (3.0, 60.0)
"""Limits of the width (standard deviation, bins) of the window around a peak."""
FIRST_WIDTH_BINS = 10.0
"""Width (standard deviation, bins) of the first window around a peak."""
ROUNDS = 12
"""Iterations of the mean shift."""
WIDE = 2.0
WIDE_ROUNDS = 4
"""Factor by which a wider window checks the result, and the iterations of mean shift in it."""
PEAK_VARIANCE_MIN = 0.3
"""Least variance of a peak, bins squared: a little more than that of counting in bins."""
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
    product = (scipy.fft.rfft(forth, TRANSFORM) * np.conj(scipy.fft.rfft(back, TRANSFORM))).sum(
        axis=0
    )
    match = scipy.fft.irfft(product, TRANSFORM).astype(np.float64)
    match = gaussian_filter1d(
        np.concatenate((match[-2 * LAGS :], match[: 2 * LAGS + 1])), SHIFT_SMOOTHING_BINS
    )

    # The best shift must be clearly better than those outside its peak.
    at = int(np.argmax(match))
    peak = float(match[at])
    match[max(at - PEAK_WIDTH_BINS, 0) : at + PEAK_WIDTH_BINS + 1] = 0.0
    clear = peak >= PEAK_MIN and float(match.max()) <= RUNNER_UP_MAX * peak
    return at - 2 * LAGS, peak if clear else 0.0


def find_two_way_paths(forth: Counts, back: Counts) -> list[tuple[int, TwoWayPath]]:
    """Find the two-way paths between two cameras; return them as (number of zone pair, path).

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
    aligned = np.zeros_like(clear[0])
    size = aligned.shape[1]
    aligned[:, max(-shift, 0) : size - max(shift, 0)] = clear[0][
        :, max(shift, 0) : size - max(-shift, 0)
    ]
    together = gaussian_filter1d(aligned * clear[1], SHIFT_SMOOTHING_BINS, axis=1, mode="constant")

    # Refine those of each pair of zones that are high enough.
    found = []
    for k in np.flatnonzero(together.max(axis=1) >= SHARE_MIN * peak):
        back_lag = int(np.argmax(together[k])) - LAGS
        path = _refine(
            (forth[k], back[k]),
            (usual[0][k], usual[1][k]),
            float(back_lag + shift),
            float(back_lag),
        )
        if path is not None:
            found.append((int(k), path))
    return found


def _refine(
    counts: tuple[Counts, Counts], usual: tuple[Counts, Counts], forth: float, back: float
) -> TwoWayPath | None:
    """Return the two-way path with peaks near given lags in both directions; None if there is none.

    counts: correlogram (lags,) of one pair of zones in each direction.
    usual: expected correlogram of each direction under the null model.
    forth, back: lags of the two peaks, bins.

    The centres of the peaks are found by mean shift in a normal window 1.5 times as wide as the
    peaks.
    """
    # Mean shift, adapting the width of the window to that of the peaks.
    centres = np.array([forth, back])
    width = FIRST_WIDTH_BINS
    within = 0.0
    error = 0.0
    spread = 0.0
    for _ in range(ROUNDS):
        step = _step(counts, usual, centres, width)
        if step is None or np.abs(step[0] - (forth, back)).max() > LAGS:
            return None
        centres, within, error = step
        within = min(max(within, PEAK_VARIANCE_MIN), 0.9 * width**2)
        # The width of a normal peak that the window has made narrower.
        spread = float(1.0 / np.sqrt(1.0 / within - 1.0 / width**2))
        last = width
        width = float(np.clip(1.5 * spread, *WIDTHS_BINS))

    # Half the difference of the two lags is the offset.
    ahead = 0.5 * float(centres[0] - centres[1])
    sd = 0.5 * error / (1.0 - within / last**2)

    # A crowd of two speeds has two peaks, and the two directions may have settled on different
    # peaks. A wider window then gives another result; the difference is added to the standard
    # deviation.
    wide = centres
    for _ in range(WIDE_ROUNDS):
        step = _step(counts, usual, wide, WIDE * width)
        wide = centres if step is None else step[0]
    other = abs(0.5 * float(wide[0] - wide[1]) - ahead)
    sd = float(np.hypot(sd, other)) if other > WIDE * sd else sd
    return TwoWayPath(ahead, sd, 0.5 * float(centres[0] + centres[1]), spread)


def _step(
    counts: tuple[Counts, Counts], usual: tuple[Counts, Counts], centres: Floats, width: float
) -> tuple[Floats, float, float] | None:
    """Do one step of the mean shift in both directions.

    counts, usual: as for `_refine`.
    centres (2,): centre of the window in each direction, bins.
    width: standard deviation of the windows, bins.

    Return the new centres (2,), the variance of the events in the windows around the old centres,
    and the standard error of the difference of the new centres; None if there are too few events.
    """
    lag = np.arange(-LAGS, LAGS + 1)
    number = np.zeros(2)
    moment = np.zeros(2)
    centre = np.zeros(2)
    error = 0.0
    for k in range(2):
        squared = (lag - centres[k]) ** 2
        window = np.exp(-0.5 * squared / width**2)
        above = window * (counts[k] - usual[k])
        number[k] = above.sum()
        if number[k] < EVENTS_MIN:
            return None
        moment[k] = above @ squared
        centre[k] = above @ lag / number[k]
        error += float((window**2 * counts[k]) @ squared) / number[k] ** 2
    return centre, float(moment.sum() / number.sum()), float(np.sqrt(error))
