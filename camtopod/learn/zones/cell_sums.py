"""Sums over events by camera and grid cell, as integers, from which zones are found.

`GridSums` holds the seven sums (`PLANES`) of each cell. Only cells that have events take memory: a
camera with a single event takes about a hundred bytes, one with events in every cell 50 KB.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Longs
from camtopod.topology import GRID_COLUMNS, GRID_ROWS

PLANES = ("count", "sx", "sy", "sxx", "sxy", "syy", "entries")
"""Names of the sums of each cell: number of events; sums of x, y, x x, x y and y y, with positions
in fixed point; number of events that are entries.
"""


class GridSums:
    """Sums over events by camera and grid cell; cameras are numbered from 0 as they are added."""

    def __init__(self) -> None:
        # For each camera the flat indices of the cells with events, ascending.
        self._cells: list[NDArray[np.intp]] = []
        # For each camera the sums (planes, cells) of these cells.
        self._sums: list[Longs] = []

    def __getitem__(self, camera: int) -> Longs:
        """Return a copy of the camera's sums (planes, rows, columns), in the order of `PLANES`."""
        whole = np.zeros((len(PLANES), GRID_ROWS * GRID_COLUMNS), np.int64)
        whole[:, self._cells[camera]] = self._sums[camera]
        return whole.reshape(-1, GRID_ROWS, GRID_COLUMNS)

    def append(self) -> None:
        """Add a camera without events."""
        self._cells.append(np.zeros(0, np.intp))
        self._sums.append(np.zeros((len(PLANES), 0), np.int64))

    def keep(self, cameras: Iterable[int]) -> None:
        """Keep only the given cameras, and number them from 0 in the given order."""
        cameras = list(cameras)
        self._cells = [self._cells[camera] for camera in cameras]
        self._sums = [self._sums[camera] for camera in cameras]

    def count(self, camera: int) -> int:
        """Return the number of events of the camera."""
        return int(self._sums[camera][0].sum())

    def add(self, camera: int, cell: NDArray[np.intp], values: Longs) -> None:
        """Add events of a camera.

        cell (n,): flat index of the grid cell of each event.
        values (planes, n): what each event adds to the sums of its cell, in the order of `PLANES`;
            negative to subtract an event that was added before.
        """
        # Insert cells that have had no events.
        cells = self._cells[camera]
        sums = self._sums[camera]
        at = np.searchsorted(cells, cell)
        if not np.array_equal(cells.take(at, mode="clip") if len(cells) else cells, cell):
            known = cells
            cells = np.union1d(cells, cell)
            wider = np.zeros((len(PLANES), len(cells)), np.int64)
            wider[:, np.searchsorted(cells, known)] = sums
            sums = wider
            at = np.searchsorted(cells, cell)

        # Add the values.
        for plane, value in zip(sums, values, strict=True):
            np.add.at(plane, at, value)

        # Drop cells that have no events any more.
        occupied = sums[0] > 0
        if not occupied.all():
            cells = cells[occupied]
            sums = sums[:, occupied]
        self._cells[camera] = cells
        self._sums[camera] = sums
