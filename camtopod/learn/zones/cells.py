"""The grid cells of one camera's view, and the sums over the events in each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from camtopod.arrays import Floats, Longs
from camtopod.topology import GRID_COLUMNS, GRID_ROWS, POSITION_ONE

CELLS = GRID_ROWS * GRID_COLUMNS
"""Number of cells of the grid."""


def fixed_point(x: ArrayLike) -> Longs:
    """Return image positions, fractions in [0, 1], as integers in fixed point (`POSITION_ONE`)."""
    return np.rint(np.asarray(x, dtype=np.float64) * POSITION_ONE).astype(np.int64)


def cells_of(px: Longs, py: Longs) -> Longs:
    """Return the flat grid cell (n,), row * columns + column, of positions; -1 for none.

    px, py (n,): positions in fixed point, negative if unknown.
    """
    column = np.minimum(px * GRID_COLUMNS // POSITION_ONE, GRID_COLUMNS - 1)
    row = np.minimum(py * GRID_ROWS // POSITION_ONE, GRID_ROWS - 1)
    return np.where(px < 0, -1, row * GRID_COLUMNS + column)


def cell_sums(px: Longs, py: Longs) -> Longs:
    """Return six sums over the events of each grid cell, (6, GRID_ROWS, GRID_COLUMNS).

    px, py (n,): known positions in fixed point.

    The sums are the number of events, and the sums of x, y, x x, x y and y y. They are integers,
    and so exact in any order of the events.
    """
    cell = cells_of(px, py)
    sums = np.zeros((6, CELLS), np.int64)
    for grid, value in zip(
        sums, (np.ones_like(px), px, py, px * px, px * py, py * py), strict=True
    ):
        np.add.at(grid, cell, value)
    return sums.reshape(6, GRID_ROWS, GRID_COLUMNS)


class Cells(NamedTuple):
    """The m occupied cells of a grid.

    index (m,): flat index of each cell, row * columns + column.
    sums (6, m): sums (n, x, y, x x, x y, y y) of each cell's events, image units.
    average (6, m): ``sums`` divided by the cell's number of events.
    spread (3, m): covariance (xx, xy, yy) of the events within each cell.
    """

    index: NDArray[np.intp]  # type: ignore[assignment]  # hides an unused method of tuple
    sums: Floats
    average: Floats
    spread: Floats

    @classmethod
    def of(cls, sums: Floats, index: NDArray[np.intp]) -> Cells:
        """Return the cells with these sums (6, m) and flat indices (m,); none may be empty."""
        average = sums / sums[0]
        _, x, y, xx, xy, yy = average
        spread = np.array((np.maximum(xx - x * x, 0), xy - x * y, np.maximum(yy - y * y, 0)))
        return cls(index, sums, average, spread)
