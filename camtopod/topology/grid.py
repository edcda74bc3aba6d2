"""Image positions as integers: fixed point, whose sums can be undone exactly, and grid blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

POSITION_ONE = 1 << 12
"""Fixed-point value of position 1.0, the whole width or height of the image."""
BLOCKS_ACROSS = 6
"""Rows, and columns, of the coarse grid that tells where along an open border an object left."""


def blocks_of(px: NDArray[np.int32], py: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the coarse-grid block (row * columns + column) of fixed-point positions; -1 for none.

    px, py (n,): positions in units of 1 / `POSITION_ONE`; negative where there is no position.
    """
    row, column = (
        np.minimum(p.astype(np.int64) * BLOCKS_ACROSS // POSITION_ONE, BLOCKS_ACROSS - 1)
        for p in (py, px)
    )
    return np.where(px < 0, -1, row * BLOCKS_ACROSS + column).astype(np.int32)


def block_of(x: float | None, y: float | None) -> int | None:
    """Return the coarse-grid block of one position in fractions of the image; None for none."""
    if x is None or y is None:
        return None
    row = round(y * POSITION_ONE) * BLOCKS_ACROSS // POSITION_ONE
    column = round(x * POSITION_ONE) * BLOCKS_ACROSS // POSITION_ONE
    return min(row, BLOCKS_ACROSS - 1) * BLOCKS_ACROSS + min(column, BLOCKS_ACROSS - 1)


GRID_ROWS = 30
"""Rows of the thesis's grid over the image (section 5.1)."""


GRID_COLUMNS = 24
"""Columns of the thesis's grid over the image (section 5.1)."""
