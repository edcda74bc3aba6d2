"""How far apart two groups of events are, along the line that tells them apart best (see `partition`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.evidence import covariance

Floats = NDArray[np.float64]
_Parts = Sequence[Any] | Floats

FAR = 3.0
"""Two centres further apart than this many of their summed standard deviations need no valley."""


def far(n: Floats, mean: Floats, scatter: Floats) -> NDArray[np.bool_]:
    """Whether two groups are `FAR` apart, from their numbers, means and squared deviations (..., 2, ...)."""
    cov, difference = covariance(n, scatter), mean[:, 1] - mean[:, 0]
    (xx, xy, yy), (x, y) = cov.sum(axis=1), difference
    # Along no line are they further apart than by the Mahalanobis distance.
    result: NDArray[np.bool_] = (yy * x - 2 * xy * y) * x + xx * y * y > 0.999 * FAR**2 * (xx * yy - xy * xy)
    if result.any():
        own, difference = cov[:, :, result], difference[:, result]
        line = discriminant(own.sum(axis=1), difference)
        apart = line[0] * difference[0] + line[1] * difference[1]
        result[result] = apart > FAR * sd_along(own, line).sum(axis=0)
    return result


def discriminant(cov: _Parts, difference: _Parts) -> tuple[Any, Any]:
    """Unit vectors (x, y) along which groups with this summed covariance (xx, xy, yy) are told apart best."""
    (xx, xy, yy), (x, y) = cov, difference
    line_x, line_y = yy * x - xy * y, xx * y - xy * x
    length = (line_x * line_x + line_y * line_y) ** 0.5 + 1e-300
    return line_x / length, line_y / length


def sd_along(cov: _Parts, line: _Parts) -> Any:
    """Standard deviation along unit vectors (x, y) of covariances (xx, xy, yy); never zero."""
    (xx, xy, yy), (x, y) = cov, line
    return (xx * x * x + 2 * xy * x * y + yy * y * y + 1e-6) ** 0.5
