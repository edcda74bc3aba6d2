"""Ways that are walked in both directions, seen by two clocks.

Where the way from zone u to zone v takes as long as the way back, the lags from u to v are later by
how much the clock at v is ahead, and those from v to u earlier by the same. So the correlogram one
way is that of the other shifted by twice the difference of the clocks, for unseen paths,
overlapping views and ways over other cameras alike.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.fft
from scipy.ndimage import gaussian_filter1d

from camtopod.arrays import Floats
from camtopod.learn.clocks.correlogram import LAGS, Counts, chance, standing_out

SHIFT_SMOOTHING_BINS = 3.0
TRANSFORM = 4 * 1024
"""Length of the transforms; holds shifts of up to 2 LAGS."""
PEAK_MIN = 3.0
PEAK_WIDTH_BINS = 60
RUNNER_UP_MAX = 0.2
"""A shift is found when no other (further off than the peak's width) explains more than this share
as much.
"""
SHARE_MIN = 0.02
"""Pairs of zones count that have at least this share of what the best shift explains."""
WIDTHS_BINS = (3.0, 60.0)
FIRST_WIDTH_BINS = 10.0
ROUNDS = 12
WIDE, WIDE_ROUNDS = 2.0, 4
"""In a window wider by this the answer must be much the same."""
WITHIN_MIN = 0.3
"""Least variance of a peak (bins squared): that of counting in bins and a little more."""
EVENTS_MIN = 8.0
"""More than chance, in each direction."""


class TwoWay(NamedTuple):
    """A way walked in both directions: how far the second clock is ahead of the first, its standard
    deviation, and the transit time in right time and its spread; all in bins.
    """

    ahead: float
    sd: float
    transit: float
    spread: float


def best_shift(forth: Counts, back: Counts) -> tuple[int, float]:
    """By how many bins the correlograms ``forth`` (K, lags) are later than those ``back`` (K,
    lags), both as `standing_out` has them, and how much of them that explains; 0.0 when it is not
    clear.
    """
    product = (scipy.fft.rfft(forth, TRANSFORM) * np.conj(scipy.fft.rfft(back, TRANSFORM))).sum(
        axis=0
    )
    match = scipy.fft.irfft(product, TRANSFORM).astype(np.float64)
    match = gaussian_filter1d(
        np.concatenate((match[-2 * LAGS :], match[: 2 * LAGS + 1])), SHIFT_SMOOTHING_BINS
    )
    at = int(np.argmax(match))
    peak = float(match[at])
    match[max(at - PEAK_WIDTH_BINS, 0) : at + PEAK_WIDTH_BINS + 1] = 0.0
    clear = peak >= PEAK_MIN and float(match.max()) <= RUNNER_UP_MAX * peak
    return at - 2 * LAGS, peak if clear else 0.0


def two_ways(forth: Counts, back: Counts) -> list[tuple[int, TwoWay]]:
    """Ways between two cameras from the correlograms of K pairs of zones, there and back: (pair,
    way).
    """
    usual = chance(forth), chance(back)
    clear = standing_out(forth, usual[0]), standing_out(back, usual[1])
    shift, peak = best_shift(*clear)
    if peak <= 0.0:
        return []
    aligned = np.zeros_like(clear[0])
    size = aligned.shape[1]
    aligned[:, max(-shift, 0) : size - max(shift, 0)] = clear[0][
        :, max(shift, 0) : size - max(-shift, 0)
    ]
    together = gaussian_filter1d(aligned * clear[1], SHIFT_SMOOTHING_BINS, axis=1, mode="constant")
    found = []
    for k in np.flatnonzero(together.max(axis=1) >= SHARE_MIN * peak):
        there = int(np.argmax(together[k])) - LAGS
        way = _centred(
            (forth[k], back[k]), (usual[0][k], usual[1][k]), float(there + shift), float(there)
        )
        if way is not None:
            found.append((int(k), way))
    return found


def _centred(
    counts: tuple[Counts, Counts], usual: tuple[Counts, Counts], forth: float, back: float
) -> TwoWay | None:
    """The way whose peaks are near these lags (bins), by mean shift in a normal window one and a
    half times as wide as the peaks; None when there is no peak.
    """
    centres, width, within, error, spread = np.array([forth, back]), FIRST_WIDTH_BINS, 0.0, 0.0, 0.0
    for _ in range(ROUNDS):
        step = _step(counts, usual, centres, width)
        if step is None or np.abs(step[0] - (forth, back)).max() > LAGS:
            return None
        centres, within, error = step
        within = min(max(within, WITHIN_MIN), 0.9 * width**2)
        spread = float(
            1.0 / np.sqrt(1.0 / within - 1.0 / width**2)
        )  # the window makes a normal peak narrower by this
        last, width = width, float(np.clip(1.5 * spread, *WIDTHS_BINS))
    ahead = 0.5 * float(centres[0] - centres[1])
    sd = 0.5 * error / (1.0 - within / last**2)
    wide = centres
    for _ in range(WIDE_ROUNDS):
        step = _step(counts, usual, wide, WIDE * width)
        wide = centres if step is None else step[0]
    # Crowds of two speeds have two peaks; there and back it may be another one that is found.
    other = abs(0.5 * float(wide[0] - wide[1]) - ahead)
    sd = float(np.hypot(sd, other)) if other > WIDE * sd else sd
    return TwoWay(ahead, sd, 0.5 * float(centres[0] + centres[1]), spread)


def _step(
    counts: tuple[Counts, Counts], usual: tuple[Counts, Counts], centres: Floats, width: float
) -> tuple[Floats, float, float] | None:
    """What is in windows around the centres (2,): its centres (2,), its variance around the old
    ones, and the standard error of the difference of the new; None when there is too little.
    """
    lag = np.arange(-LAGS, LAGS + 1)
    number, moment, centre, error = np.zeros(2), np.zeros(2), np.zeros(2), 0.0
    for k in range(2):
        squared = (lag - centres[k]) ** 2
        window = np.exp(-0.5 * squared / width**2)
        above = window * (counts[k] - usual[k])
        number[k] = above.sum()
        if number[k] < EVENTS_MIN:
            return None
        moment[k], centre[k] = above @ squared, above @ lag / number[k]
        error += float((window**2 * counts[k]) @ squared) / number[k] ** 2
    return centre, float(moment.sum() / number.sum()), float(np.sqrt(error))
