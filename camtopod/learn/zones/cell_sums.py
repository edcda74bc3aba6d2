"""Integer sums over events by camera and grid cell. Only cells that have events take memory: a
camera with one event takes some hundred bytes, one that is busy everywhere 50 KB.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Longs
from camtopod.topology import GRID_COLUMNS, GRID_ROWS

PLANES = ("count", "sx", "sy", "sxx", "sxy", "syy", "entries")


class GridSums:
    """``sums[camera]`` (planes, rows, columns) is a copy. Cameras are counted from 0 in the order
    they come.
    """

    def __init__(self) -> None:
        self._cells: list[
            NDArray[np.intp]
        ] = []  # of each camera: flat index of the cells with events, ascending
        self._sums: list[Longs] = []  # (planes, cells)

    def __getitem__(self, camera: int) -> Longs:
        whole = np.zeros((len(PLANES), GRID_ROWS * GRID_COLUMNS), np.int64)
        whole[:, self._cells[camera]] = self._sums[camera]
        return whole.reshape(-1, GRID_ROWS, GRID_COLUMNS)

    def append(self) -> None:
        """One more camera, without events."""
        self._cells.append(np.zeros(0, np.intp))
        self._sums.append(np.zeros((len(PLANES), 0), np.int64))

    def keep(self, cameras: Iterable[int]) -> None:
        """Forget all cameras but these, which are numbered anew in this order."""
        cameras = list(cameras)
        self._cells = [self._cells[camera] for camera in cameras]
        self._sums = [self._sums[camera] for camera in cameras]

    def count(self, camera: int) -> int:
        """Events of the camera."""
        return int(self._sums[camera][0].sum())

    def add(self, camera: int, cell: NDArray[np.intp], values: Longs) -> None:
        """Add ``values`` (planes, n) of events in the cells ``cell`` (n,); those of events that are
        taken back are negative.
        """
        cells, sums = self._cells[camera], self._sums[camera]
        at = np.searchsorted(cells, cell)
        if not np.array_equal(cells.take(at, mode="clip") if len(cells) else cells, cell):
            known, cells = cells, np.union1d(cells, cell)
            wider = np.zeros((len(PLANES), len(cells)), np.int64)
            wider[:, np.searchsorted(cells, known)] = sums
            sums, at = wider, np.searchsorted(cells, cell)

        for plane, value in zip(sums, values, strict=True):
            np.add.at(plane, at, value)

        some = sums[0] > 0
        if not some.all():
            cells, sums = cells[some], sums[:, some]
        self._cells[camera], self._sums[camera] = cells, sums
