"""Evidence that a group of events is a zone and no piece of a way between zones, for `partition`.

Tracks lost or found between zones are clutter as narrow as a zone, and dense where ways cross. But
a way goes on, straight or bent: on two sides of such a group, events are about as dense as in the
group. A group that reaches the border of the view is no way through it: people cross a long border
all along.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist

from camtopod.arrays import Floats
from camtopod.learn.zones.cells import Cells
from camtopod.learn.zones.clutter import DENSER
from camtopod.learn.zones.marginal_likelihood import covariance, moments
from camtopod.topology import GRID_COLUMNS, GRID_ROWS

WAY_CONTRAST = 4.0
"""Least ratio of a zone's density to the density of the ways through it."""
WAY_NATS = 30.0
FEW_SHARE = 0.05
"""Evidence that a group is denser than the way through it, up to which its ratio counts in part, if
it has less than this share of the camera's events: a few events on a way are close together by
chance somewhere.
"""
LEAST_WAY = 0.0005
"""Least density of a way, as a share of the camera's events under the kernel: a way on which few
tracks were lost has gaps.
"""
CELL_SPREAD = np.array([[1 / (12 * GRID_COLUMNS**2)], [0.0], [1 / (12 * GRID_ROWS**2)]])
"""Covariance (xx, xy, yy) of a uniform distribution over one cell, image units."""
_ROUNDER = 0.2
"""Share of the sum of a group's variances that is added along both axes, as ways are bent."""
_KERNEL = 0.7
"""Standard deviation of the kernel that measures density, in those of the group."""
_REACH = 1.75
"""Distance from the border of the view, in standard deviations, within which a group reaches it: an
even strip along the border has its centre at 1.73.
"""
_LONG = 0.08
"""Largest standard deviation of a zone away from the border, image units; of a larger group, this
much around its centre is looked at.
"""
_BEND = 0.4
"""Factor on the density of a way each time that it turns aside from its ray."""
_DIRECTIONS = 16
_BACK = (6, 7, 8, 9, 10)
"""Sixteenths of a circle from a ray to the opposite one and to those beside it: a way may turn
within a group.
"""
_RAYS_BACK = np.subtract.outer(np.arange(_DIRECTIONS), _BACK)
_RAYS_BESIDE = np.subtract.outer(np.arange(_DIRECTIONS), (1, _DIRECTIONS - 1))
_ANGLE = np.linspace(0.0, 2 * np.pi, _DIRECTIONS, endpoint=False)
_RAYS = np.multiply.outer(np.arange(0.5, 4.5, 0.5), np.array((np.cos(_ANGLE), np.sin(_ANGLE))).T)
_PLACES = np.concatenate((np.zeros((1, 2)), _RAYS.reshape(-1, 2)))
"""Centre of a group and places on rays out of it, (places, 2), in the group's deviations."""


def way_contrast(cells: Cells, group: Floats, rates: Floats) -> float:
    """Return the ratio of a group's density to that of the densest way through it.

    group (6,): its sums. rates (rows, columns): expected events of clutter in each cell.

    A way runs outwards, on a ray or aside to the next one, up to a denser zone or to four
    deviations, and is as dense as its least dense place. It needs two rays that are roughly
    opposite, and the sparser one counts, less half of the expected clutter, plus `LEAST_WAY`. The
    density of the group is taken one standard error lower, and the ratio of a group of few events
    (`FEW_SHARE`) counts in part while its evidence is below `WAY_NATS`. It is infinite for a group
    at the border.
    """
    mean, scatter = moments(group)
    xx, xy, yy = covariance(group[0], scatter) + CELL_SPREAD[:, 0]
    across = np.sqrt((xx - xy * xy / yy, yy - xy * xy / xx))  # with the other coordinate given
    if (np.minimum(mean, 1 - mean) < _REACH * across).any():
        return np.inf
    rounding = _ROUNDER * (xx + yy)
    root = np.linalg.cholesky(np.array([[xx + rounding, xy], [xy, yy + rounding]]))
    root *= min(1.0, _LONG / np.sqrt(max(xx, yy)))
    events = np.linalg.solve(root, cells.average[1:3] - mean[:, None]).T
    density = np.exp(cdist(_PLACES, events, "sqeuclidean") / (-2 * _KERNEL**2)) @ cells.sums[0]

    # The way out along each ray, from its end inwards, and the two rays of the densest way.
    centre_density, rays = float(density[0]), density[1:].reshape(-1, _DIRECTIONS)
    way = rays[-1]
    for ring in rays[-2::-1]:
        on = np.maximum(way, _BEND * way[_RAYS_BESIDE].max(axis=1))
        way = np.where(ring > DENSER * centre_density, ring, np.minimum(ring, on))
    through = float(np.minimum(way, way[_RAYS_BACK].max(axis=1)).max())

    # The expected clutter under the kernel, whose area is in cells.
    area = 2 * np.pi * _KERNEL**2 * root[0, 0] * root[1, 1] * GRID_ROWS * GRID_COLUMNS
    column, row = (mean * (GRID_COLUMNS, GRID_ROWS)).astype(np.intp)
    even = area * rates[min(row, GRID_ROWS - 1), min(column, GRID_COLUMNS - 1)]
    through = max(through - even / 2, 0.0) + LEAST_WAY * float(cells.sums[0].sum())
    contrast = (1 - group[0] ** -0.5) * centre_density / through
    if group[0] < FEW_SHARE * cells.sums[0].sum():
        ratio = max(centre_density / through, 1.0)
        contrast *= min(group[0] * (np.log(ratio) - 1 + 1 / ratio) / WAY_NATS, 1.0)
    return float(contrast)
