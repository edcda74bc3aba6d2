"""Evidence that a group of events is one zone: marginal likelihood under a Gaussian.

A group of events is given by its six sums (n, Sx, Sy, Sxx, Sxy, Syy) in image units; the sums of
two groups add up to those of their union. The functions here take many groups at once: an array
(6, ...) of sums, or arrays computed from it. The Gaussian's mean is unknown with a flat prior over
the image (area 1). Its covariance is unknown with an inverse Wishart prior that expects a zone of
standard deviation `ZONE_SD` and weighs as much as one or two events.

The alternative to a zone is clutter, which is uniform over the image: its likelihood is 1 (log 0)
for any number of events. A group of a single event has likelihood 1 as a zone, too, so a single
event never makes a zone.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaln, multigammaln

from camtopod.arrays import Floats

ZONE_SD = 0.02
"""Prior standard deviation of a zone, image units. The prior is wide: a third of this or three
times as much costs little evidence.
"""
_FREEDOM = 4.0
"""Degrees of freedom of the inverse Wishart prior."""
_SCALE = 5 * ZONE_SD**2
"""Scale of the inverse Wishart prior, the same along both axes."""


def moments(groups: Floats) -> tuple[Floats, Floats]:
    """Return the mean (2, ...) and the scatter (3, ...) of groups given by their sums (6, ...).

    The scatter holds the sums of products of deviations from the mean, as xx, xy, yy.
    """
    mean = groups[1:3] / np.maximum(groups[0], 1e-12)
    (sx, sy) = groups[1:3]
    (x, y) = mean
    return mean, groups[3:] - np.array((sx * x, sx * y, sy * y))


def covariance(n: Floats, scatter: Floats) -> Floats:
    """Return the posterior covariance (3, ...: xx, xy, yy) of groups.

    n (...): number of events of each group.
    scatter (3, ...): as returned by `moments`.
    """
    xx, xy, yy = scatter
    cov: Floats = np.array((xx + _SCALE, xy, yy + _SCALE)) / (n + (_FREEDOM - 1))
    return cov


def log_zone(n: Floats, scatter: Floats) -> Floats:
    """Return the log probability (...) of each group as one zone, relative to clutter.

    n (...): number of events of each group.
    scatter (3, ...): as returned by `moments`.

    The result is the log marginal likelihood of the group plus the group's term in the log prior of
    the partition (`log_zones`). With this value of `_FREEDOM` the gamma
    functions of the two reduce, by the duplication formula, to powers of two times the same
    factorial.
    """
    factorial = gammaln(n + 1)
    n = np.maximum(n, 1.0)
    xx, xy, yy = scatter
    determinant = (xx + _SCALE) * (yy + _SCALE) - xy * xy
    result: Floats = (
        factorial + np.maximum(factorial, 0.0) + np.log((n + 1) / n) - n * _LOG_TAU + _CONSTANT
    )
    result -= (0.5 * (_FREEDOM - 1) + 0.5 * n) * np.log(determinant)
    return result


def log_zones(zones: int, total: Floats) -> Floats:
    """Return the log prior of a partition of ``total`` events into ``zones`` zones and clutter.

    It is a Dirichlet multinomial over unordered zones. The terms of the single zones (see
    `log_zone`) and of the clutter (log factorial of its events) are left out.
    """
    weight = zones + 1
    result: Floats = gammaln(zones + 1) + gammaln(weight) - gammaln(total + weight)
    return result


_CONSTANT = float(_FREEDOM * np.log(_SCALE) - multigammaln(_FREEDOM / 2, 2) + np.log(np.pi**2 / 2))
"""Terms of `log_zone` that do not depend on the group."""
_LOG_TAU = float(np.log(2 * np.pi))
