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

from camtopod.arrays import Floats, Longs
from camtopod.learn.paths.camera_lags import CameraLags, keys

WIDTHS = tuple(2.0**k for k in range(6))
"""Widths of peaks that are tried, seconds."""
HALF_WINDOW = 1.5
"""Half of the window of lags of a peak, and the least distance of two peaks of one pair, in widths.
"""
SURROUNDINGS = 12
"""Widths of the surroundings on each side of a peak, in half windows."""
PEAKS_PER_WIDTH = 2
PEAKS_PER_PAIR = 4
"""Peaks of one pair of cameras: of each width, and in all."""
CANDIDATES_LEAST = 3
"""Candidates of a pair of cameras below which no peak is looked for."""
DEGREE = 3.0
"""Expected number of paths from one camera."""
NEAR_SECONDS = 40.0
"""Scale of the places of paths between neighbours."""
FAR_SHARE = 0.35
"""Share of the paths whose place may be anywhere in the range of lags."""
WIDTH_SECONDS = 3.0
"""Middle of the widths of paths, which differ by a factor of e."""
COST_NATS = 2.0
"""Evidence that a peak needs beyond that against the prior."""
SCORE_LEAST = -2.0
"""Least sum of gain and log prior of a peak, nats."""
OWN_SHARE = 0.15
"""Prior odds of a path that leads back to the own camera over one between two cameras."""


class Peaks(NamedTuple):
    """K peaks, ordered by pair of cameras."""

    pair: Longs
    """(K,) pair of cameras (`CameraLags`)."""
    place: Floats
    """(K,) lag in the middle, seconds."""
    width: Floats
    """(K,) width, seconds."""


class _Window(NamedTuple):
    """Windows of one width about lags of the grid: indices of their edges, (windows,)."""

    width: float
    apart: int
    """Windows on each side of a peak that are no peaks of their own."""
    place: Floats
    """(windows,) lag in the middle, seconds."""
    low: Longs
    high: Longs
    far_low: Longs
    far_high: Longs
    prior: Floats
    """(windows,) log prior of a path at this place, nats."""


def find_peaks(lags: CameraLags) -> Peaks:
    """Return the peaks of the lags of all pairs of cameras."""
    grid = np.arange(lags.lag_min, lags.lag_max + lags.resolution, lags.resolution)
    windows = [_window(width, grid, lags.resolution, lags.cameras) for width in WIDTHS]
    found = [
        peak for source in range(lags.cameras) for peak in _peaks_from(lags, source, grid, windows)
    ]
    table = np.array(found).reshape(-1, 3)
    return Peaks(table[:, 0].astype(np.int64), table[:, 1], table[:, 2])


def _window(width: float, grid: Floats, resolution: float, cameras: int) -> _Window:
    """Return the windows of one width (seconds) about each lag of the grid (lags, seconds)."""
    half = round(HALF_WINDOW * width / resolution)
    step = max(half // 3, 1)
    at = np.arange(0, len(grid), step)
    place = grid[at]
    far = half + SURROUNDINGS * half + SURROUNDINGS // 2

    # Log of the expected number of paths of a pair at this place, of about this width.
    near = np.exp(-np.abs(place) / NEAR_SECONDS) / NEAR_SECONDS
    density = (1 - FAR_SHARE) * near + FAR_SHARE / (grid[-1] - grid[0])
    prior = np.log(DEGREE / max(cameras - 1, 1) * np.minimum(density * width, 0.5))
    prior -= 0.5 * np.log(width / WIDTH_SECONDS) ** 2 + COST_NATS
    low, high, far_low, far_high = (
        np.clip(edge, 0, len(grid)) for edge in (at - half, at + half + 1, at - far, at + far + 1)
    )
    return _Window(width, (3 * half + 2) // step, place, low, high, far_low, far_high, prior)


def _peaks_from(
    lags: CameraLags, source: int, grid: Floats, windows: list[_Window]
) -> list[tuple[int, float, float]]:
    """Return the peaks of the pairs that lead from one camera: pair, place and width of each."""
    # Departures exposed to each lag, summed up to each lag of the grid.
    of = lags.source == source
    left, dwell = np.sort(lags.left[of]), np.sort(lags.dwell[of])
    after = np.searchsorted(left, lags.until - grid, side="right")
    before = len(dwell) - np.searchsorted(dwell, -grid)
    exposed = _summed(lags.resolution * np.where(grid >= 0, after, before)[None, :])[0]

    # Candidates by target and lag, weighed by 1 / rate, and their squared weights.
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
    cell = ((lags.lag[first:end] - grid[0]) / lags.resolution + 0.5).astype(np.int64)
    target = lags.target[lags.arrival[first:end]]
    targets = np.flatnonzero(np.bincount(target, minlength=cameras) >= CANDIDATES_LEAST)
    row = np.full(cameras, len(targets))
    row[targets] = np.arange(len(targets))
    cell = row[target] * len(grid) + np.minimum(cell, len(grid) - 1)
    counted, squared = (
        _summed(np.bincount(cell, w, (len(targets) + 1) * len(grid)).reshape(-1, len(grid))[:-1])
        for w in (weight, weight**2)
    )

    # The best peaks of each width, then the best of each pair that are apart.
    found: list[tuple[float, int, float, float]] = []
    for window in windows:
        score = window.prior + _gain(window, counted, squared, exposed)
        score[targets == source] += np.log(OWN_SHARE)
        for _ in range(PEAKS_PER_WIDTH):
            best = score.argmax(axis=1)
            for k, at in enumerate(best.tolist()):
                if score[k, at] > SCORE_LEAST:
                    peak = int(targets[k]), float(window.place[at]), window.width
                    found.append((-float(score[k, at]), *peak))
                score[k, max(0, at - window.apart) : at + window.apart + 1] = -np.inf
    kept: dict[int, list[tuple[float, float]]] = {}
    for _, to, place, width in sorted(found):
        others = kept.setdefault(to, [])
        if len(others) < PEAKS_PER_PAIR and all(
            abs(place - other) > HALF_WINDOW * max(width, wide) for other, wide in others
        ):
            others.append((place, width))
    return [
        (source * cameras + to, place, width) for to in sorted(kept) for place, width in kept[to]
    ]


def _summed(values: NDArray[Any]) -> Floats:
    """Return the sums (rows, columns + 1) of the values before each column."""
    result = np.zeros((len(values), values.shape[1] + 1))
    np.cumsum(values, axis=1, out=result[:, 1:])
    return result


def _gain(window: _Window, counted: Floats, squared: Floats, exposed: Floats) -> Floats:
    """Return the gain (targets, windows, nats) of a path in each window over chance.

    counted, squared (targets, lags + 1), exposed (lags + 1): weighed candidates, squared weights
        and what chance makes expect, up to each lag.

    It is the log likelihood ratio of Poisson counts, n ln(n / e) - (n - e). Expected is the larger
    of chance and the surroundings.
    """
    inside = counted[:, window.high] - counted[:, window.low]
    spread = squared[:, window.high] - squared[:, window.low]
    chance = exposed[window.high] - exposed[window.low]
    around = counted[:, window.far_high] - counted[:, window.far_low] - inside
    around_chance = exposed[window.far_high] - exposed[window.far_low] - chance
    usual = chance * np.maximum(1.0, around / np.maximum(around_chance, 1e-9))

    # In numbers of candidates instead of seconds.
    unit = inside / np.maximum(spread, 1e-12)
    n = inside * unit
    e = np.maximum(usual * unit, 1e-3)
    gain = np.zeros(n.shape)
    more = n > e
    n, e = n[more], e[more]
    gain[more] = n * np.log(n / e) - (n - e)
    return gain
