"""Lag bins: a time scale for lags that is fine near zero and coarse far from it.

Bins are uniform in asinh(lag / scale): about ``scale * step`` seconds wide near zero, and a
constant share of the lag far from it, as the spread of transit times grows with their length. Lags
outside the range have no bin (-1): in an end bin they would look like a peak.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, row_slices

LAG_SCALE_SECONDS = 4.0
"""Lag at which bins change from constant width to a constant share of the lag, seconds."""
LAG_STEP = 0.1
"""Width of a bin in asinh(lag / scale): about 0.4 s near zero, a tenth of the lag far from it."""
CELLS_PER_BIN = 1.001
"""Cells of the lookup table per width of the narrowest bin; above 1, so no cell has two edges."""
OFFSET_SECONDS_MAX = 600.0
"""Largest offset between the beginnings of two passages that is compared, seconds."""


class LagBins:
    """Bins that cover lags from ``lag_min`` to ``lag_max`` seconds, both included."""

    def __init__(
        self,
        lag_min: float,
        lag_max: float,
        scale: float = LAG_SCALE_SECONDS,
        step: float = LAG_STEP,
    ) -> None:
        if not lag_min < lag_max:
            raise ValueError(f"lag range is empty: {lag_min} to {lag_max} s")
        self.lag_min, self.lag_max, self.scale, self.step = lag_min, lag_max, scale, step
        self.first = int(np.floor(np.arcsinh(lag_min / scale) / step))
        """Number of the first bin, counted from the bin that starts at a lag of 0."""
        last = int(np.floor(np.arcsinh(lag_max / scale) / step))
        self.size = last - self.first + 1
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

        # Lookup table for `index`: the bin in which each cell begins. Cells are narrower than any
        # bin, so at most one edge lies within a cell.
        self._cells_per_second = CELLS_PER_BIN / float(self.widths.min())
        cells = math.ceil((lag_max - lag_min) * self._cells_per_second) + 1
        starts = lag_min + np.arange(cells) / self._cells_per_second
        self._ends = np.array([*self.limits[1:-1], np.inf])
        self._bin_of_cell = np.searchsorted(self.limits[1:-1], starts, side="right").astype(
            np.int32
        )

    def bin_of(self, lag: float) -> int:
        """Return the bin of one lag (seconds); -1 outside the range."""
        at = bisect_right(self.limits, lag) - 1
        return at if at < self.size else -1

    def index(self, lag: NDArray[np.float64]) -> NDArray[np.int32]:
        """Return the bin of each lag (n,) in seconds; -1 outside the range."""
        cell = ((lag - self.lag_min) * self._cells_per_second).astype(np.intp)
        k: NDArray[np.int32] = self._bin_of_cell.take(cell, mode="clip")
        k += lag >= self._ends.take(k)  # whether the edge within the cell has been passed
        k[~((lag >= self.lag_min) & (lag <= self.lag_max))] = -1
        return k


def offset_bins(scale: float, step: float) -> LagBins:
    """Return bins for the offset between the beginnings of two passages."""
    return LagBins(-OFFSET_SECONDS_MAX, OFFSET_SECONDS_MAX, scale, step)


@lru_cache(maxsize=64)
def lag_smoothing_matrix(size: int, sd_bins: float) -> NDArray[np.float64]:
    """Return a Gaussian kernel (size, size) that spreads the mass of each bin over its neighbours.

    Columns sum to 1, so mass is kept.

    sd_bins: standard deviation, in bins.
    """
    offset = np.arange(size)[:, None] - np.arange(size)[None, :]
    kernel: NDArray[np.float64] = np.exp(-0.5 * (offset / sd_bins) ** 2)
    kernel /= kernel.sum(axis=0, keepdims=True)
    kernel.flags.writeable = False
    return kernel


SMOOTHING_SD_BINS = ((50.0, 1.2), (12.0, 1.8), (0.0, 2.8))
"""Pairs (least expected transitions, standard deviation in bins): fewer are smoothed more."""


def smooth(counts: Floats, total: Floats | None = None) -> tuple[Floats, Floats]:
    """Smooth counts (P, bins) over neighbouring bins; rows with fewer transitions more widely.

    Returns the smoothed counts, and for each row (P,) the share of a bin's mass that stays in it.

    total (P,): transitions that decide the width; by default the row sums.
    """
    size = counts.shape[1]
    total = counts.sum(axis=1) if total is None else total
    result = np.zeros_like(counts)
    stays = np.zeros(len(total))
    above = np.full(len(total), False)

    # Each row is smoothed once, with the width of the highest threshold that it reaches.
    for least, sd_bins in SMOOTHING_SD_BINS:
        few = np.flatnonzero((total >= least) & ~above)
        above[few] = True
        spread = lag_smoothing_matrix(size, sd_bins)
        for part in row_slices(len(few)):
            rows = few[part]
            result[rows] = counts[rows] @ spread.T
            stays[rows] = spread[size // 2, size // 2]
    return result, stays
