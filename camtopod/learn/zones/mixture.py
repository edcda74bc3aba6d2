"""Assign grid cells to known zones: a Gaussian mixture with clutter (thesis 2.8, eq. 2.5, 2.6).

Once a camera's zones are known, `classify_cells` computes for every cell of the grid which zone, or
clutter, an event in the cell most probably belongs to. Events lie on the grid, so this one table
classifies all events until the zones are learned again.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats
from camtopod.topology import GRID_COLUMNS, GRID_ROWS

_LOG_TAU = float(np.log(2 * np.pi))
_X = (np.arange(GRID_COLUMNS) + 0.5) / GRID_COLUMNS
_Y = ((np.arange(GRID_ROWS) + 0.5) / GRID_ROWS)[:, None]
Covariance = tuple[tuple[float, float], tuple[float, float]]


class Component(Protocol):
    """A Gaussian of the mixture: mean, covariance and weight."""

    @property
    def x(self) -> float:
        """Mean x, as a fraction of the image's width."""

    @property
    def y(self) -> float:
        """Mean y, as a fraction of the image's height."""

    @property
    def cov(self) -> Covariance:
        """Covariance (2, 2) of (x, y), in the same fractions."""

    @property
    def weight(self) -> float:
        """Share of this Gaussian among the events of all Gaussians, in (0, 1]."""


def log_density(x: Floats, y: Floats, component: Component) -> Floats:
    """Return the log of the Gaussian density averaged over a grid cell with centre (x, y).

    Eq. 2.5, whose printed normaliser lacks a root. A zone may be narrower than a cell, so the
    variance of a uniform distribution over the cell (a twelfth of its squared sides) is added.
    """
    return _log_density(x, y, *_figures(component))


def _figures(component: Component) -> tuple[float, float, float, float, float]:
    """Return mean x, mean y, and the covariance as xx, xy, yy, of a component."""
    (xx, xy), (_, yy) = component.cov
    return component.x, component.y, xx, xy, yy


def _log_density(x: Floats, y: Floats, *figures: float | Floats) -> Floats:
    """Compute `log_density` for the `_figures` of a component, or of several as arrays.

    Arrays must broadcast with the positions.
    """
    mean_x, mean_y, xx, xy, yy = figures
    xx = xx + 1 / (12 * GRID_COLUMNS**2)
    yy = yy + 1 / (12 * GRID_ROWS**2)
    dx = x - mean_x
    dy = y - mean_y
    determinant = xx * yy - xy * xy
    # If x varies along columns and y along rows only, just the last line works on all cells.
    of_x = (-0.5 * yy / determinant) * dx * dx - (_LOG_TAU + 0.5 * np.log(determinant))
    of_y = (-0.5 * xx / determinant) * dy * dy
    density: Floats = (xy / determinant * dx) * dy + of_x + of_y
    return density


def classify_cells(components: Sequence[Component], clutter: float | Floats) -> NDArray[np.int16]:
    """Return the component with the largest posterior (eq. 2.6) in each grid cell, -1 for clutter.

    components: the zones of the camera; the result holds indices into them.
    clutter (scalar or (GRID_ROWS, GRID_COLUMNS)): number of clutter events per event in a zone,
        times the density of clutter in the cell relative to its mean over the image.
    """
    scores = np.empty((len(components) + 1, GRID_ROWS, GRID_COLUMNS))
    scores[0] = np.log(np.maximum(clutter, 1e-3))
    if components:
        figures = np.array([(*_figures(component), component.weight) for component in components])
        *shape, weight = figures.T[:, :, None, None]
        scores[1:] = np.log(weight) + _log_density(_X, _Y, *shape)
    return np.asarray(scores.argmax(axis=0) - 1, dtype=np.int16)
