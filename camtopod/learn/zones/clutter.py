"""Clutter: events that belong to no zone, how dense they are, and DaSpec without them.

Clutter is made of tracks that begin or end anywhere in the view, such as broken tracks and false
detections. DaSpec makes zones of clutter (5 % uniform clutter gives 6 to 9 zones instead of 3), so
clutter is removed first. `clutter_rates` estimates the expected number of clutter events around
each cell from the sparse cells; this rate varies over the image, but on a larger scale than a zone.
`dense_cells` removes the clutter, and `daspec_groups` groups the cells that remain: these groups
are the starting point of `partition`.
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
"""Least ratio of a zone's density to the density of the clutter around it."""
FLOOR_PROBABILITY = 0.01
"""A cell is kept for DaSpec if clutter alone would put as many events into its surroundings with
less than this probability.
"""
FLOOR_WIDTH = 1.75
"""Standard deviation of the kernel that defines a cell's surroundings, grid steps."""
WIDTH = 4.0
"""Standard deviation, grid steps, of the kernel that averages clutter; larger than a zone."""
DENSER = 2.0
"""A cell counts as clutter up to this multiple of the local rate of clutter, plus three standard
deviations of Poisson noise and one event; and a way ends in a place this many times as dense as a
group on it.
"""
EVENTS_ALIKE = 30.0
"""Weight, in events, of the rate of the whole image in the local rate of clutter."""
ROUNDS_MAX = 8
"""Most iterations of the clutter estimates, and most rounds of moves of `partition`."""
_WIDE_ROWS = kernel_1d(GRID_ROWS, WIDTH)
_WIDE_COLUMNS = kernel_1d(GRID_COLUMNS, WIDTH)


_ROWS = kernel_1d(GRID_ROWS, FLOOR_WIDTH)
_COLUMNS = kernel_1d(GRID_COLUMNS, FLOOR_WIDTH)


def clutter_rate(count: Counts) -> float:
    """Return the number of clutter events per cell, from events ``count`` (rows, columns).

    The rate is the mean over the cells that are not significantly above it, found by iteration.
    """
    n = np.sort(count, axis=None).astype(np.float64)
    upto = np.cumsum(n)
    rate = float(upto[-1]) / len(n)
    for _ in range(ROUNDS_MAX):
        below = int(np.searchsorted(n, rate + 3 * math.sqrt(rate) + 1, side="right"))
        before = rate
        rate = float(upto[below - 1]) / below
        if abs(rate - before) < 1e-6:
            return max(before, 1e-6)
    return max(rate, 1e-6)


def clutter_rates(count: Counts) -> Floats:
    """Return the expected number of clutter events in each cell, in the shape of ``count``.

    count (rows, columns): events of each cell.

    Clutter is denser where people walk or light flickers. The rates start at `DENSER` times
    the `clutter_rate` of the whole image and fall from iteration to iteration, until the set of
    cells that count as clutter no longer changes.
    """
    n = np.asarray(count, dtype=np.float64)
    mean = clutter_rate(count)
    rate = np.full(n.shape, DENSER * mean)
    mask = np.zeros(n.shape, dtype=np.bool_)
    for _ in range(ROUNDS_MAX):
        before = mask
        mask = n <= DENSER * rate + 3 * np.sqrt(rate) + 1
        if (mask == before).all():
            break
        weight, around = _WIDE_ROWS @ np.array((mask, mask * n)) @ _WIDE_COLUMNS
        rate = np.minimum(rate, (around + EVENTS_ALIKE) / (weight + EVENTS_ALIKE / mean))
    return rate


def dense_cells(count: Counts, rate: Floats) -> Floats:
    """Return the events beyond the expected clutter in cells that stand out, 0 in all others.

    count, rate (rows, columns): events of each cell, and expected events of clutter.

    A kernel-weighted sum of Poisson counts is distributed approximately like one count over
    (sum K)^2 / (sum K^2) cells.
    """
    keep = (count > rate + 2 * np.sqrt(rate)) & (count > CONTRAST_MIN * rate)
    cells = _ROWS @ np.ones(keep.shape) @ _COLUMNS / (_ROWS**2 @ np.ones(keep.shape) @ _COLUMNS**2)
    inside, expected = (_ROWS @ np.array((count, rate)) @ _COLUMNS * cells)[:, keep]
    keep[keep] = gammainc(np.maximum(inside, 1e-9), expected) < FLOOR_PROBABILITY
    return np.where(keep, np.maximum(count - rate, 0.5), 0.0)


def daspec_groups(dense: Floats) -> Labels:
    """Return the DaSpec group of each cell (rows * columns,), -1 where ``dense`` is 0.

    dense (rows, columns): events of the cells to group (`dense_cells`).
    """
    # Half the bandwidth of the rule: too many groups are fine, as `partition` merges groups.
    dense = dense.copy()
    width = max(bandwidth(dense) / 2, BANDWIDTH_MIN)
    labels = np.full(dense.size, -1, dtype=np.intp)
    groups = 0
    while dense.any():
        # Keep the groups of the cells that the eigenvectors of this run reach.
        spectra = data_spectroscopy(dense, width)
        entry = spectra.vectors[np.arange(len(spectra.cells)), spectra.labels]
        mask = entry > spectra.vectors.max(axis=0)[spectra.labels] * max(1 / dense.sum(), 1e-3)
        labels[spectra.cells[mask]] = spectra.labels[mask] + groups
        groups += spectra.groups

        # Run again on the other cells.
        dense.ravel()[spectra.cells[mask]] = 0
        if not mask.any():
            break
    return labels
