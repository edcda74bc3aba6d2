"""Image positions as integers: fixed point, cells of a fine grid, and blocks of a coarse grid.

Sums of positions in fixed point can be subtracted exactly. Zones are found on the fine grid; the
blocks tell where along an open border of the view an object left.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

POSITION_ONE = 1 << 12
"""Fixed-point value of position 1.0, the whole width or height of the image."""
BLOCKS_ACROSS = 6
"""Number of rows, and of columns, of the coarse grid of blocks."""


def blocks_of(px: NDArray[np.int32], py: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the block (n,), as row * columns + column, of positions; -1 for unknown positions.

    px, py (n,): positions in units of 1 / `POSITION_ONE`; negative if unknown.
    """
    row, column = (
        np.minimum(p.astype(np.int64) * BLOCKS_ACROSS // POSITION_ONE, BLOCKS_ACROSS - 1)
        for p in (py, px)
    )
    return np.where(px < 0, -1, row * BLOCKS_ACROSS + column).astype(np.int32)


def block_of(x: float | None, y: float | None) -> int | None:
    """Return the block of one position in fractions of the image; None for an unknown position."""
    if x is None or y is None:
        return None
    row = round(y * POSITION_ONE) * BLOCKS_ACROSS // POSITION_ONE
    column = round(x * POSITION_ONE) * BLOCKS_ACROSS // POSITION_ONE
    return min(row, BLOCKS_ACROSS - 1) * BLOCKS_ACROSS + min(column, BLOCKS_ACROSS - 1)


GRID_ROWS = 30
"""Number of rows of the fine grid over the image, as in the thesis (section 5.1)."""


GRID_COLUMNS = 24
"""Number of columns of the fine grid over the image, as in the thesis (section 5.1)."""
