"""Doors in mid-view: places away from the border where people appear and disappear again and again.

One track that begins or ends in mid-view is most often a mistake - somebody walked out of a group,
behind a tree, or stood until the tracker lost him. A place is admitted as a door only when several
objects began or ended there without any other explanation, and more of them did so than walked
through; until then nothing is reported there.
"""

from __future__ import annotations

from collections import deque

import numpy as np

DOOR_EVENTS_MIN = 3
"""Unexplained beginnings and endings a door needs."""
DOOR_HEIGHTS = 0.6
"""They lie within this many heights of the person of each other."""
REMEMBERED_MAX = 200
"""So many unexplained beginnings and endings are remembered, the latest."""
GRID_ROWS, GRID_COLUMNS = 24, 32


class Doors:
    """Learns the doors of one view; positions in pixels of the working picture."""

    def __init__(self, width: int, height: int) -> None:
        self._size = (width, height)
        self._unexplained: deque[tuple[float, float]] = deque(maxlen=REMEMBERED_MAX)
        self._passed = np.zeros((GRID_ROWS, GRID_COLUMNS), np.int32)

    def _cell(self, x: float, y: float) -> tuple[int, int]:
        row = int(y / self._size[1] * GRID_ROWS)
        column = int(x / self._size[0] * GRID_COLUMNS)
        return min(max(row, 0), GRID_ROWS - 1), min(max(column, 0), GRID_COLUMNS - 1)

    def learn(self, x: float, y: float) -> None:
        """An object began or ended at this foot point in mid-view, for no known reason."""
        self._unexplained.append((x, y))

    def walked(self, feet: set[tuple[int, int]]) -> None:
        """An object went through these cells (see `cells`) without beginning or ending there."""
        for row, column in feet:
            self._passed[row, column] += 1

    def cell(self, x: float, y: float) -> tuple[int, int]:
        """The grid cell of a foot point, for `walked`."""
        return self._cell(x, y)

    def is_door(self, x: float, y: float, height: float) -> bool:
        """Whether an object ``height`` pixels tall that begins or ends at this foot point uses a
        door.
        """
        radius = DOOR_HEIGHTS * height
        near = sum(
            1 for a, b in self._unexplained if (a - x) ** 2 + (b - y) ** 2 <= radius * radius
        )
        return near >= DOOR_EVENTS_MIN and near > int(self._passed[self._cell(x, y)])
