"""How far apart two groups of events are, along the line that tells them apart best (see
`partition`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from camtopod.arrays import Floats
from camtopod.learn.zones.marginal_likelihood import covariance

_Parts = Sequence[Any] | Floats

FAR = 3.0
"""Two centres further apart than this many of their summed standard deviations need no valley."""


def far(n: Floats, mean: Floats, scatter: Floats) -> NDArray[np.bool_]:
    """Whether two groups are `FAR` apart, from their numbers, means and squared deviations (..., 2,
    ...).
    """
    cov, difference = covariance(n, scatter), mean[:, 1] - mean[:, 0]
    (xx, xy, yy), (x, y) = cov.sum(axis=1), difference
    # Along no line are they further apart than by the Mahalanobis distance.
    result: NDArray[np.bool_] = (yy * x - 2 * xy * y) * x + xx * y * y > 0.999 * FAR**2 * (
        xx * yy - xy * xy
    )
    if result.any():
        own, difference = cov[:, :, result], difference[:, result]
        line = discriminant(own.sum(axis=1), difference)
        apart = line[0] * difference[0] + line[1] * difference[1]
        result[result] = apart > FAR * sd_along(own, line).sum(axis=0)
    return result


def discriminant(cov: _Parts, difference: _Parts) -> tuple[Any, Any]:
    """Unit vectors (x, y) along which groups with this summed covariance (xx, xy, yy) are told
    apart best.
    """
    (xx, xy, yy), (x, y) = cov, difference
    line_x, line_y = yy * x - xy * y, xx * y - xy * x
    length = (line_x * line_x + line_y * line_y) ** 0.5 + 1e-300
    return line_x / length, line_y / length


def sd_along(cov: _Parts, line: _Parts) -> Any:
    """Standard deviation along unit vectors (x, y) of covariances (xx, xy, yy); never zero."""
    (xx, xy, yy), (x, y) = cov, line
    return (xx * x * x + 2 * xy * x * y + yy * y * y + 1e-6) ** 0.5


DEPTH = 0.85
"""A valley is at most so dense in terms of its flanks; shallower ones are ripples, whatever their
significance."""
_STEPS = 18
"""Grid points along the line."""
_STEP = np.arange(_STEPS)
_WIDTH = np.maximum(_STEP - _STEP[:, None], 1)
_INNER = [(low, high) for low in range(1, _STEPS - 2) for high in range(low + 1, _STEPS - 1)]
"""Stretches that may be a valley: there is something on either side. Below, each with each of its
flanks to the left, then each with each to the right, by the flat index (from, to) of the valley, of
the flank, and of both together."""
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
_STARTS = np.flatnonzero(np.diff(_VALLEYS, prepend=-1))
_ONE_SIDE = len(_INNER)


def valley(n: Floats, position: Floats, sd: Floats, low: float, high: float) -> float:
    """Log likelihood ratio for a valley somewhere in [low, high].

    ``n`` events each (m,) at ``position`` (m,) along the line with spread ``sd`` (m,).
    """
    grid = low + (high - low) / (_STEPS - 1) * _STEP
    below = ndtr((grid[:, None] - position) / sd) @ n
    inside = np.maximum(below - below[:, None], 1e-9)
    rate = inside / _WIDTH
    own = (inside * np.log(rate)).ravel()
    ratio = own[_VALLEYS] + own[_FLANKS] - own[_WHOLES]
    rate = rate.ravel()
    # One that is not clearly less dense than its flank is no valley.
    ratio *= rate[_VALLEYS] < DEPTH * rate[_FLANKS]
    best = np.maximum.reduceat(ratio, _STARTS)
    return max(float(np.minimum(best[:_ONE_SIDE], best[_ONE_SIDE:]).max()), 0.0)
