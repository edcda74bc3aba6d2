"""Classification by a Gaussian mixture with uniform clutter (thesis section 2.8, eq. 2.5-2.6)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.settings import GRID_COLUMNS, GRID_ROWS

Floats = NDArray[np.float64]
Covariance = tuple[tuple[float, float], tuple[float, float]]


class Component(Protocol):
    """A Gaussian of the mixture: mean, covariance, and its share among the Gaussians."""

    @property
    def x(self) -> float:
        """Mean, fraction of the image's width."""

    @property
    def y(self) -> float:
        """Mean, fraction of the image's height."""

    @property
    def cov(self) -> Covariance:
        """Covariance (2, 2) of (x, y), in the same fractions."""

    @property
    def weight(self) -> float:
        """Share of the Gaussians' events that are of this one, in (0, 1]."""


def log_density(x: Floats, y: Floats, component: Component) -> Floats:
    """Log of the Gaussian density (eq. 2.5, whose printed normaliser lacks a root) averaged over a cell at
    (x, y).

    A zone may be narrower than a cell, so the cell's own spread, a twelfth of its squared sides, is added.
    """
    (xx, xy), (_, yy) = component.cov
    xx, yy = xx + 1 / (12 * GRID_COLUMNS**2), yy + 1 / (12 * GRID_ROWS**2)
    dx, dy = x - component.x, y - component.y
    determinant = xx * yy - xy * xy
    squared = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / determinant
    density: Floats = -0.5 * squared - np.log(2 * np.pi) - 0.5 * np.log(determinant)
    return density


def classify_cells(components: Sequence[Component], clutter: float | Floats) -> NDArray[np.int16]:
    """The component with the largest posterior (eq. 2.6) in each cell, or -1 where clutter is likelier.

    ``clutter`` is the number of events outside all zones per event inside, times how dense it is in each cell in terms
    of an even spread. Shape (GRID_ROWS, GRID_COLUMNS).
    """
    x = np.broadcast_to((np.arange(GRID_COLUMNS) + 0.5) / GRID_COLUMNS, (GRID_ROWS, GRID_COLUMNS))
    y = np.broadcast_to(((np.arange(GRID_ROWS) + 0.5) / GRID_ROWS)[:, None], (GRID_ROWS, GRID_COLUMNS))
    scores = [np.broadcast_to(np.log(np.maximum(clutter, 1e-3)), (GRID_ROWS, GRID_COLUMNS))]
    scores += [np.log(component.weight) + log_density(x, y, component) for component in components]
    return np.asarray(np.stack(scores).argmax(axis=0) - 1, dtype=np.int16)
