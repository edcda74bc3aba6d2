"""Evidence that two groups of events in a view are separate, for `partition`.

Two groups are separate if there is a *valley*, a stretch of low density, between them
(`valley_between`), on the line that discriminates the two best (`discriminant`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from camtopod.arrays import Floats
from camtopod.learn.zones.cells import Cells
from camtopod.learn.zones.marginal_likelihood import covariance, moments

_Parts = Sequence[Any] | Floats


def discriminant(cov: _Parts, difference: _Parts) -> tuple[Any, Any]:
    """Return the unit vectors (x, y) along which pairs of groups are discriminated best.

    cov (xx, xy, yy): sum of the covariances of the two groups.
    difference (x, y): difference of the means of the two groups.

    The elements may be numbers or arrays over pairs.
    """
    (xx, xy, yy) = cov
    (x, y) = difference
    line_x = yy * x - xy * y
    line_y = xx * y - xy * x
    length = (line_x * line_x + line_y * line_y) ** 0.5 + 1e-300
    return line_x / length, line_y / length


def sd_along(cov: _Parts, line: _Parts) -> Any:
    """Return the standard deviation, never zero, of distributions along a line.

    cov (xx, xy, yy): covariance of each distribution.
    line (x, y): unit vector of each line.
    """
    (xx, xy, yy) = cov
    (x, y) = line
    return (xx * x * x + 2 * xy * x * y + yy * y * y + 1e-6) ** 0.5


_STEPS = 18
"""Number of grid points along the line."""
_STEP = np.arange(_STEPS)
_WIDTH = np.maximum(_STEP - _STEP[:, None], 1)
_INNER = [(low, high) for low in range(1, _STEPS - 2) for high in range(low + 1, _STEPS - 1)]
"""Stretches (from, to) of the grid that may be a valley, with room for a flank on either side."""
# Every combination of a valley with a flank on its left, then with one on its right: the flat index
# (from, to) of the valley, of the flank, and of the two together.
_VALLEYS, _FLANKS, _WHOLES = np.array(
    [
        *[(b * _STEPS + c, a * _STEPS + b, a * _STEPS + c) for b, c in _INNER for a in range(b)],
        *[
            (b * _STEPS + c, c * _STEPS + d, b * _STEPS + d)
            for b, c in _INNER
            for d in range(c + 1, _STEPS)
        ],
    ]
).T.copy()
# Where the combinations of each valley begin; the first `_ONE_SIDE` have the flank on the left.
_STARTS = np.flatnonzero(np.diff(_VALLEYS, prepend=-1))
_ONE_SIDE = len(_INNER)


def valley_between(
    cells: Cells,
    a: Floats,
    b: Floats,
    inside: NDArray[np.bool_],
    outside: NDArray[np.bool_],
    weight: float,
) -> float:
    """Return the log likelihood ratio of a valley between two groups, at least 0.

    a, b (6,): sums of the groups.
    inside, outside (m,): masks of their cells and of the cells of clutter.
    weight: what an event counts.
    """
    # The line that discriminates the two best, and the distance of the centres along it.
    groups = np.stack((a, b), axis=1)
    mean, scatter = moments(groups)
    cov = covariance(groups[0], scatter)
    (x, to_x), (y, to_y) = mean.tolist()
    to_x = to_x - x
    to_y = to_y - y
    line_x, line_y = line = discriminant(cov.sum(axis=1).tolist(), (to_x, to_y))
    covs = cov.T.tolist()
    sd_a, sd_b = (sd_along(cov_of_one, line) for cov_of_one in covs)
    apart = line_x * to_x + line_y * to_y
    if apart == 0.0:
        return 0.0  # there is nothing between equal centres

    # Clutter in the tube between the two belongs to the valley.
    dx = cells.average[1] - x
    dy = cells.average[2] - y
    along = line_x * dx + line_y * dy
    aside = line_x * dy - line_y * dx - along * ((line_x * to_y - line_y * to_x) / apart)
    width = max(sd_along(cov_of_one, (-line_y, line_x)) for cov_of_one in covs)
    tube = (outside) & (along > 0) & (along < apart) & (np.abs(aside) < 2 * width)

    # The valley along the line, from two standard deviations before to two behind the centres.
    rows = np.flatnonzero(inside | tube)
    n = cells.sums[0, rows] * weight
    sd = sd_along(cells.spread[:, rows], line)
    return valley_log_ratio(n, along[rows], sd, -2 * sd_a, apart + 2 * sd_b)


def valley_log_ratio(n: Floats, position: Floats, sd: Floats, low: float, high: float) -> float:
    """Return the log likelihood ratio for a valley somewhere in [low, high], at least 0.

    n (m,): number of events of each cell.
    position, sd (m,): mean and standard deviation of each cell's events along the line.
    low, high: ends of the stretch of the line, in the unit of ``position``.

    A valley is a stretch of the line with a flank on either side. With a valley, the events have
    one density in the valley and another in the flank; without, both have the same. On each side
    the flank with the largest ratio counts, and of the two sides the one with the smaller ratio.
    """
    # Events and density of every stretch (from, to) of the grid.
    grid = low + (high - low) / (_STEPS - 1) * _STEP
    below = ndtr((grid[:, None] - position) / sd) @ n
    inside = np.maximum(below - below[:, None], 1e-9)
    rate = inside / _WIDTH

    # Log likelihood ratio of every valley with every flank.
    log_likelihood = (inside * np.log(rate)).ravel()
    ratio = log_likelihood[_VALLEYS] + log_likelihood[_FLANKS] - log_likelihood[_WHOLES]
    rate = rate.ravel()
    ratio *= rate[_VALLEYS] < rate[_FLANKS]

    # The best flank on either side, the worse of the two sides, and the best valley.
    best = np.maximum.reduceat(ratio, _STARTS)
    return max(float(np.minimum(best[:_ONE_SIDE], best[_ONE_SIDE:]).max()), 0.0)
