"""Assign grid cells to known zones: a Gaussian mixture with clutter (thesis 2.8, eq. 2.5, 2.6).

Once a camera's zones (`ZoneShape`) are known, `classify_cells` computes for every cell of the grid
which zone, or clutter, an event in the cell most probably belongs to. Events lie on the grid, so
this one table classifies all events until the zones are learned again.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from camtopod.arrays import Floats
from camtopod.topology import GRID_COLUMNS, GRID_ROWS

_LOG_TAU = float(np.log(2 * np.pi))
CELL_X = (np.arange(GRID_COLUMNS) + 0.5) / GRID_COLUMNS
CELL_Y = ((np.arange(GRID_ROWS) + 0.5) / GRID_ROWS)[:, None]


class ZoneShape(Struct, frozen=True):
    """One zone of a camera, as a Gaussian.

    number: identifies the zone among all zones that the camera ever had; from 1.
    x, y, cov: mean and covariance of its events, in image units (fractions of the image's width and
        height).
    weight: its share of the camera's events that are in zones.
    """

    number: int
    x: float
    y: float
    cov: tuple[tuple[float, float], tuple[float, float]]
    weight: float


def classify_cells(zones: Sequence[ZoneShape], clutter: float | Floats) -> NDArray[np.int16]:
    """Return the zone with the largest posterior (eq. 2.6) in each grid cell, -1 for clutter.

    zones: the zones of the camera; the result holds indices into them.
    clutter (scalar or (GRID_ROWS, GRID_COLUMNS)): number of clutter events per event in a zone,
        times the density of clutter in the cell relative to its mean over the image.

    The density of a zone is averaged over a cell: the variance of a uniform distribution over the
    cell (a twelfth of its squared sides) is added, as a zone may be narrower. (The printed
    normaliser of eq. 2.5 lacks a root.)
    """
    scores = np.empty((len(zones) + 1, GRID_ROWS, GRID_COLUMNS))
    scores[0] = np.log(np.maximum(clutter, 1e-3))
    if zones:
        figures = np.array([(z.x, z.y, *z.cov[0], z.cov[1][1], z.weight) for z in zones])
        x, y, xx, xy, yy, weight = figures.T[:, :, None, None]
        xx = xx + 1 / (12 * GRID_COLUMNS**2)
        yy = yy + 1 / (12 * GRID_ROWS**2)
        dx = CELL_X - x
        dy = CELL_Y - y
        determinant = xx * yy - xy * xy
        # x varies along columns and y along rows only: just the last line works on all cells.
        of_x = (-0.5 * yy / determinant) * dx * dx - (_LOG_TAU + 0.5 * np.log(determinant))
        of_y = (-0.5 * xx / determinant) * dy * dy
        density = (xy / determinant * dx) * dy + of_x + of_y
        scores[1:] = np.log(weight) + density
    return np.asarray(scores.argmax(axis=0) - 1, dtype=np.int16)
