"""Lag bins: bins for lags (seconds from departure to arrival), fine near zero, coarse far from it.

Bins are uniform in asinh(lag / scale): about ``scale * step`` seconds wide near zero, and a
constant share of the lag far from zero, as the spread of transit times grows with their length.
Lags outside the range have no bin (-1): if they were counted in the end bins, these would look like
peaks. `smooth` smooths histograms over the bins.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, row_slices
from camtopod.records import LAG_SCALE_SECONDS as LAG_SCALE_SECONDS, LAG_STEP as LAG_STEP

LAGS_AT_ONCE = 1 << 15
"""Number of lags whose bins are looked up at one time, few enough for a processor's cache."""
OFFSET_SECONDS_MAX = 600.0
"""Largest offset between the beginnings of two passages that has a bin, seconds."""


DWELL_SECONDS_MAX = 180.0
"""Longest stay in one view that has a bin: who stays longer has not just passed through."""


class LagBins:
    """Bins that cover lags from ``lag_min`` to ``lag_max`` seconds, both included.

    scale (seconds), step: as `LAG_SCALE_SECONDS` and `LAG_STEP`, which are the defaults.
    """

    def __init__(
        self,
        lag_min: float,
        lag_max: float,
        scale: float = LAG_SCALE_SECONDS,
        step: float = LAG_STEP,
    ) -> None:
        if not lag_min < lag_max:
            raise ValueError(f"lag range is empty: {lag_min} to {lag_max} s")
        self.lag_min = lag_min
        self.lag_max = lag_max
        self.scale = scale
        self.step = step
        self.first = int(np.floor(np.arcsinh(lag_min / scale) / step))
        """Number of the first bin, counted from the bin that starts at a lag of 0."""
        last = int(np.floor(np.arcsinh(lag_max / scale) / step))
        self.size = last - self.first + 1
        """Number of bins."""
        self.edges: NDArray[np.float64] = scale * np.sinh(step * np.arange(self.first, last + 2))
        """Bin edges in seconds, (size + 1,)."""
        self.widths: NDArray[np.float64] = np.diff(self.edges)
        """Bin widths in seconds, (size,)."""
        self.centres: NDArray[np.float64] = scale * np.sinh(
            step * (np.arange(self.first, last + 1) + 0.5)
        )
        """Bin centres on the asinh scale, in seconds, (size,)."""
        self.limits: list[float] = [
            lag_min,
            *self.edges[1:-1].tolist(),
            math.nextafter(lag_max, math.inf),
        ]
        """Bin edges clipped to the range, seconds, (size + 1,).

        Bin ``k`` holds ``limits[k]`` <= lag < ``limits[k + 1]``.
        """

        # A table of narrow cells, in which `index` looks up bins: a cell and the one before it have
        # one edge at most.
        self._inner: NDArray[np.float64] = np.append(self.edges[1:-1], np.inf)
        self._cell = 0.49 * float(self.widths.min())
        cells = np.arange(int((self.edges[-1] - self.edges[0]) / self._cell) + 2)
        before = self.edges[0] + (cells - 1) * self._cell
        self._bin_of_cell = np.searchsorted(self._inner, before, side="right").astype(np.int32)

    def bin_of(self, lag: float) -> int:
        """Return the index of the bin of one lag (seconds); -1 if it is outside the range."""
        at = bisect_right(self.limits, lag) - 1
        return at if at < self.size else -1

    def index(self, lag: NDArray[np.float64]) -> NDArray[np.int32]:
        """Return the index of the bin of each lag, (n,); -1 for lags outside the range.

        lag (n, seconds): the lags; any shape is possible.
        """
        flat = lag.reshape(-1)
        result = np.empty(lag.size, np.int32)
        for first in range(0, lag.size, LAGS_AT_ONCE):
            part = flat[first : first + LAGS_AT_ONCE].astype(np.float64, copy=False)
            cell = np.clip((part - self.edges[0]) / self._cell, 0, len(self._bin_of_cell) - 1)
            at = self._bin_of_cell.take(cell.astype(np.intp))
            at += part >= self._inner.take(at)
            at[(part < self.lag_min) | (part > self.lag_max)] = -1
            result[first : first + LAGS_AT_ONCE] = at
        return result.reshape(lag.shape)


def dwell_bins() -> LagBins:
    """Return the bins of the dwell times in one view."""
    return LagBins(0.0, DWELL_SECONDS_MAX)


def offset_bins(scale: float = LAG_SCALE_SECONDS, step: float = LAG_STEP) -> LagBins:
    """Return bins for offsets: seconds by which one passage begins later than another.

    scale, step: as for `LagBins`.
    """
    return LagBins(-OFFSET_SECONDS_MAX, OFFSET_SECONDS_MAX, scale, step)


@lru_cache(maxsize=64)
def lag_smoothing_matrix(size: int, sd_bins: float) -> NDArray[np.float64]:
    """Return a Gaussian kernel (size, size) that spreads the mass of each bin over its neighbours.

    size: number of bins.
    sd_bins: standard deviation of the kernel, in bins.

    Columns sum to 1, so the total mass stays the same.
    """
    offset = np.arange(size)[:, None] - np.arange(size)[None, :]
    kernel: NDArray[np.float64] = np.exp(-0.5 * (offset / sd_bins) ** 2)
    kernel /= kernel.sum(axis=0, keepdims=True)
    kernel.flags.writeable = False
    return kernel


SMOOTHING_SD_BINS = ((50.0, 1.2), (12.0, 1.8), (0.0, 2.8))
"""Kernels of `smooth`: (least number of transitions, standard deviation in bins) of each.

Histograms of fewer transitions are smoothed more widely.
"""


def smooth(counts: Floats, total: Floats | None = None) -> tuple[Floats, Floats]:
    """Smooth histograms over neighbouring lag bins, those of fewer transitions more widely.

    counts (P, bins): P histograms of transitions.
    total (P,): number of transitions that decides the width of the kernel; None for the row sums.

    Return the smoothed counts, and for each histogram (P,) the share of a bin's count that stays in
    the bin.
    """
    size = counts.shape[1]
    total = counts.sum(axis=1) if total is None else total
    result = np.zeros_like(counts)
    own_share = np.zeros(len(total))
    above = np.full(len(total), False)

    # Each row is smoothed once, with the kernel of the highest threshold that it reaches.
    for least, sd_bins in SMOOTHING_SD_BINS:
        full_rows = np.flatnonzero((total >= least) & ~above)
        above[full_rows] = True
        spread = lag_smoothing_matrix(size, sd_bins)
        for part in row_slices(len(full_rows)):
            rows = full_rows[part]
            result[rows] = counts[rows] @ spread.T
            own_share[rows] = spread[size // 2, size // 2]
    return result, own_share
