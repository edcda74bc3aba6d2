"""The density floor, and DaSpec over what stands out of it: the first groups of cells (see `partition`).

A camera also sees things begin and end anywhere, by broken tracks and false alarms: uniform clutter, of
which DaSpec makes zones of its own (5 % clutter gives 6 to 9 instead of 3). Its rate is known from the sparse
cells.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc

from camtopod.learn.daspec import BANDWIDTH_MIN, bandwidth, data_spectroscopy, kernel_1d
from camtopod.learn.settings import GRID_COLUMNS, GRID_ROWS

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]
Counts = NDArray[np.int64] | Floats

CONTRAST_MIN = 1.5
"""A zone is at least so many times as dense as clutter."""
FLOOR_CHANCE = 0.05
"""A cell is kept for DaSpec when clutter alone would fill its surroundings like this with at most this
probability."""
FOUND_CHANCE = 0.0001
"""The same for looking again among what was left as clutter."""
FLOOR_WIDTH = 1.75
"""Width of a cell's surroundings, grid steps."""
PEELS_MAX = 3
"""DaSpec runs at most so often, each time over what no kept eigenvector reached."""
_ROWS, _COLUMNS = kernel_1d(GRID_ROWS, FLOOR_WIDTH), kernel_1d(GRID_COLUMNS, FLOOR_WIDTH)
_AREA = np.outer(_ROWS.sum(axis=0), _COLUMNS.sum(axis=0))
_AREA_SQUARED = np.outer((_ROWS**2).sum(axis=0), (_COLUMNS**2).sum(axis=0))


def clutter_rate(count: Counts) -> float:
    """Events of uniform clutter per cell: the mean over the cells that are not significantly above it."""
    n = count.ravel().astype(np.float64)
    rate = float(n.mean())
    for _ in range(8):
        below = float(n[n <= rate + 3 * np.sqrt(rate) + 1].mean())
        if abs(below - rate) < 1e-6:
            break
        rate = below
    return max(rate, 1e-6)


def dense_cells(count: Counts, chance: float) -> Floats:
    """Counts above the clutter, 0 in cells whose surroundings clutter would fill like this with at least
    ``chance``."""
    rate = clutter_rate(count)
    # A kernel-weighted sum of Poisson counts is much like one count over (sum K)^2 / (sum K^2) cells.
    inside = _ROWS @ count @ _COLUMNS * _AREA / _AREA_SQUARED
    dense = gammainc(np.maximum(inside, 1e-9), rate * _AREA**2 / _AREA_SQUARED) < chance
    keep = dense & (count > rate + 2 * np.sqrt(rate)) & (count > CONTRAST_MIN * rate)
    return np.where(keep, np.maximum(count - rate, 0.5), 0.0)


def groups_of(dense: Floats) -> Labels:
    """DaSpec's groups of the dense cells, flat (rows * columns), -1 elsewhere."""
    dense = dense.copy()
    width = max(bandwidth(dense) / 2, BANDWIDTH_MIN)
    labels = np.full(dense.size, -1, dtype=np.intp)
    groups = 0
    for _ in range(PEELS_MAX):
        found = data_spectroscopy(dense, width)
        own = found.vectors[np.arange(len(found.cells)), found.labels]
        reached = own > found.vectors.max(axis=0)[found.labels] * max(1 / dense.sum(), 1e-3)
        labels[found.cells[reached]] = found.labels[reached] + groups
        groups += found.groups
        dense.ravel()[found.cells[reached]] = 0
        if not dense.any():
            break
    return labels
