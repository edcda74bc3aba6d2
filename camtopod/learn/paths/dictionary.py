"""The dictionary of paths: peaks of the lags of each pair of cameras.

Lags of unrelated cameras are spread like the rate of arrivals; a path adds a bell to them. Windows
of lags of several widths are compared with what chance and the surrounding lags make expect. Most
peaks are false, and that is as it should be: the joint fit decides, and leaving a true one out
costs more than keeping false ones.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Longs, Singles
from camtopod.learn.lags import BIN_SECONDS, poisson_nats
from camtopod.learn.paths.camera_lags import CameraLags, keys
from camtopod.learn.traffic import RATIO_MAX

WIDTHS = tuple(2.0**k for k in range(6))
"""Widths of peaks that are tried, seconds."""
HALF_WINDOW = 1.5
"""Half of the window of lags of a peak, and the least distance of two peaks of one pair, in widths.
"""
SURROUNDINGS = 12
"""Widths of the surroundings on each side of a peak, in half windows."""
DEGREE = 3.0
"""Expected number of paths from one camera."""


class _Window(NamedTuple):
    """Windows of one width about lags of the grid: indices of their edges, (windows,)."""

    width: float
    place: Floats
    """(windows,) lag in the middle, seconds."""
    low: Longs
    high: Longs
    far_low: Longs
    far_high: Longs
    prior: Floats
    """(windows,) log prior of a path at this place, nats."""


def find_peaks(lags: CameraLags, favour: Singles) -> tuple[Longs, Floats, Floats]:
    """Return the peaks of the lags of all pairs of cameras, ordered by pair.

    favour (cameras, cameras): factor on the prior odds of a path from each camera to each.

    They are columns (K,): pair of cameras (`CameraLags`), lag in the middle, and width, seconds.
    """
    grid = np.arange(lags.lag_min, lags.lag_max + BIN_SECONDS, BIN_SECONDS)
    windows = [_window(width, grid, lags.cameras) for width in WIDTHS]
    peaks = [
        peak
        for source in range(lags.cameras)
        for peak in _peaks_from(lags, source, grid, windows, np.log(favour[source]))
    ]
    table = np.array(peaks).reshape(-1, 3)
    return table[:, 0].astype(np.int64), table[:, 1], table[:, 2]


def log_density(place: Floats, width: Floats | float, lag_max: float) -> Floats:
    """Return the log probability (n,) that a path of some width is at each place and no other.

    All scales of places up to the longest lag are equally likely.

    place, width (n, seconds): places and widths of paths; lag_max (seconds): the longest lag.
    """
    density: Floats = width / (np.abs(place) + width) / np.log1p(lag_max / width)
    return np.log(density)


def _window(width: float, grid: Floats, cameras: int) -> _Window:
    """Return the windows of one width (seconds) about each lag of the grid (lags, seconds)."""
    half = round(HALF_WINDOW * width / BIN_SECONDS)
    step = max(half // 3, 1)
    at = np.arange(0, len(grid), step)
    place = grid[at]
    far = half + SURROUNDINGS * half + SURROUNDINGS // 2

    # Log of the expected number of paths of a pair at this place.
    prior = np.log(DEGREE / max(cameras - 1, 1)) + log_density(place, width, grid[-1])
    low, high, far_low, far_high = (
        np.clip(edge, 0, len(grid)) for edge in (at - half, at + half + 1, at - far, at + far + 1)
    )
    return _Window(width, place, low, high, far_low, far_high, prior)


def _peaks_from(
    lags: CameraLags, source: int, grid: Floats, windows: list[_Window], prior: Floats
) -> list[tuple[int, float, float]]:
    """Return the peaks of the pairs that lead from one camera: pair, place and width of each.

    prior (targets,): log of the factor on the prior odds of a path to each camera, nats.
    """
    # Departures exposed to each lag, summed up to each lag of the grid.
    of = lags.source == source
    departure_t, dwell = np.sort(lags.departure_t[of]), np.sort(lags.dwell[of])
    after = np.searchsorted(departure_t, lags.until - grid, side="right")
    before = len(dwell) - np.searchsorted(dwell, -grid)
    exposure = _summed(BIN_SECONDS * np.where(grid >= 0, after, before)[None, :])[0]

    # Candidates by target and lag, weighed by 1 / rate and labels, and their squared weights.
    cameras = lags.cameras
    first, end = np.searchsorted(
        lags.key,
        keys(
            np.array([source, source + 1]) * cameras,
            np.full(2, lags.lag_min),
            lags.lag_min,
            lags.lag_max,
        ),
    )
    weight = 1.0 / lags.rate[lags.arrival[first:end]]
    if lags.likeness is not None:
        weight *= np.minimum(lags.likeness[first:end], RATIO_MAX)
    cell = ((lags.lag[first:end] - grid[0]) / BIN_SECONDS + 0.5).astype(np.int64)
    target = lags.target[lags.arrival[first:end]]
    cell = target * len(grid) + np.minimum(cell, len(grid) - 1)
    counts, square_sums = (
        _summed(np.bincount(cell, w, cameras * len(grid)).reshape(cameras, -1))
        for w in (weight, weight**2)
    )

    # The best peak of each width, then those of each pair that are apart, the best first.
    peaks: list[tuple[float, int, float, float]] = []
    for window in windows:
        score = window.prior + prior[:, None] + _gain(window, counts, square_sums, exposure)
        best = score.argmax(axis=1)
        for to in np.flatnonzero(score.max(axis=1) > 0.0).tolist():
            at = best[to]
            peaks.append((-float(score[to, at]), to, float(window.place[at]), window.width))
    peaks_by_target: dict[int, list[tuple[float, float]]] = {}
    for _, to, place, width in sorted(peaks):
        target_peaks = peaks_by_target.setdefault(to, [])
        if all(
            abs(place - other_place) > HALF_WINDOW * max(width, wide)
            for other_place, wide in target_peaks
        ):
            target_peaks.append((place, width))
    return [
        (source * cameras + to, place, width)
        for to in sorted(peaks_by_target)
        for place, width in peaks_by_target[to]
    ]


def _summed(values: NDArray[Any]) -> Floats:
    """Return the sums (rows, columns + 1) of the values before each column."""
    return np.cumsum(np.pad(values, ((0, 0), (1, 0))), axis=1, dtype=float)


def _gain(window: _Window, counts: Floats, square_sums: Floats, exposure: Floats) -> Floats:
    """Return the gain (targets, windows, nats) of a path in each window over chance.

    counts, square_sums (targets, lags + 1), exposure (lags + 1): weighed candidates, squared
        weights and what chance makes expect, up to each lag.

    Expected is the larger of chance and the surroundings.
    """
    inside = counts[:, window.high] - counts[:, window.low]
    spread = square_sums[:, window.high] - square_sums[:, window.low]
    chance = exposure[window.high] - exposure[window.low]
    around = counts[:, window.far_high] - counts[:, window.far_low] - inside
    around_chance = exposure[window.far_high] - exposure[window.far_low] - chance
    usual = chance * np.maximum(1.0, around / np.maximum(around_chance, 1e-9))

    # In numbers of candidates instead of seconds.
    unit = inside / np.maximum(spread, 1e-12)
    return poisson_nats(inside * unit, np.maximum(usual * unit, 1e-3))
