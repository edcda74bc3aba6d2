"""The density floor, and DaSpec over what stands out of it: the first groups of cells (see
`partition`).

A camera also sees things begin and end anywhere, by broken tracks and false alarms: clutter, of
which DaSpec makes zones of its own (5 % uniform clutter gives 6 to 9 instead of 3). Its rate is
known from the sparse cells; it changes over the image, but over wider stretches than a zone's.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc

from camtopod.arrays import Floats
from camtopod.learn.zones.daspec import BANDWIDTH_MIN, bandwidth, data_spectroscopy, kernel_1d
from camtopod.topology import GRID_COLUMNS, GRID_ROWS

Labels = NDArray[np.intp]
Counts = NDArray[np.int64] | Floats

CONTRAST_MIN = 2.5
"""A zone is at least so many times as dense as the clutter around it."""
FLOOR_CHANCE = 0.01
"""A cell is kept for DaSpec when clutter alone would fill its surroundings like this with at most
this probability."""
FOUND_CHANCE = 0.0001
"""The same for looking again among what was left as clutter."""
FLOOR_WIDTHS = (0.75, 1.75)
"""Widths of a cell's surroundings, grid steps: a fire door's, and that of a zone of few events."""
PEELS_MAX = 3
"""DaSpec runs at most so often, each time over what no kept eigenvector reached."""
WIDTH = 4.0
"""Clutter's rate is a mean over this width, grid steps: broader than a zone."""
DENSER = 2.0
"""A cell so many times as dense as the clutter around it is not clutter, however many events there
are.
"""
DENSER_MAX = 4.0
"""Clutter is nowhere denser than this many times its mean."""
EVENTS_ALIKE = 30.0
"""With fewer events of clutter around a cell its rate is more that of the whole image."""
ROUNDS = 8
_WIDE_ROWS, _WIDE_COLUMNS = kernel_1d(GRID_ROWS, WIDTH), kernel_1d(GRID_COLUMNS, WIDTH)


def _surroundings(width: float) -> tuple[Floats, Floats, Floats]:
    rows, columns = kernel_1d(GRID_ROWS, width), kernel_1d(GRID_COLUMNS, width)
    area = np.outer(rows.sum(axis=0), columns.sum(axis=0))
    return rows, columns, area / np.outer((rows**2).sum(axis=0), (columns**2).sum(axis=0))


_ROWS, _COLUMNS, _SCALES = (
    np.array(parts) for parts in zip(*map(_surroundings, FLOOR_WIDTHS), strict=True)
)


def clutter_rate(count: Counts) -> float:
    """Events of clutter per cell: the mean over the cells that are not significantly above it."""
    n = np.sort(count, axis=None).astype(np.float64)
    upto = np.cumsum(n)
    rate = float(upto[-1]) / len(n)
    for _ in range(ROUNDS):
        below = int(np.searchsorted(n, rate + 3 * math.sqrt(rate) + 1, side="right"))
        before, rate = rate, float(upto[below - 1]) / below
        if abs(rate - before) < 1e-6:
            return max(before, 1e-6)
    return max(rate, 1e-6)


def clutter_rates(count: Counts) -> Floats:
    """`clutter_rate` around each cell, shape of ``count``: clutter is thicker where people walk or
    light flickers.

    From at most `DENSER_MAX` of the whole image's rate it falls until nothing stands out.
    """
    n = np.asarray(count, dtype=np.float64)
    mean = clutter_rate(count)
    rate = np.full(n.shape, DENSER_MAX * mean)
    kept = np.zeros(n.shape, dtype=np.bool_)
    for _ in range(ROUNDS):
        before, kept = kept, n <= DENSER * rate + 3 * np.sqrt(rate) + 1
        if (kept == before).all():
            break  # the same cells have the same mean
        weight, around = _WIDE_ROWS @ np.array((kept, kept * n)) @ _WIDE_COLUMNS
        rate = np.minimum(rate, (around + EVENTS_ALIKE) / (weight + EVENTS_ALIKE / mean))
    return rate


def _chance(count: Counts, rate: Floats, which: NDArray[np.bool_]) -> Floats:
    """Probability that clutter fills a cell's surroundings like this, for the size of surroundings
    where it is least, of the cells of the mask ``which``; 1 where it is not small.

    A kernel-weighted sum of Poisson counts is much like one count over (sum K)^2 / (sum K^2) cells.
    """
    inside, expected = (_ROWS @ np.array((count, rate))[:, None] @ _COLUMNS * _SCALES)[:, :, which]
    # Up to a standard deviation above what is expected it is a seventh and more, far from any
    # chance asked for.
    some = inside > expected + np.sqrt(expected)
    chances = np.ones(inside.shape)
    chances[some] = gammainc(np.maximum(inside[some], 1e-9), expected[some])
    return np.asarray(chances.min(axis=0))


def dense_cells(count: Counts, rate: Floats, chance: float) -> Floats:
    """Counts above the clutter's ``rate``, 0 in cells whose surroundings clutter would fill like
    this with at least ``chance``."""
    keep = (count > rate + 2 * np.sqrt(rate)) & (count > CONTRAST_MIN * rate)
    if not keep.any():
        return np.zeros(keep.shape)
    keep[keep] = _chance(count, rate, keep) < chance
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
