"""Evidence of a group of events being one zone: the marginal likelihood of a Gaussian of unknown
mean and covariance.

A group is six sums (n, Sx, Sy, Sxx, Sxy, Syy) in image units, first axis of every array here;
groups add up. The mean has a flat prior over the image (area 1), the covariance an inverse Wishart
prior that expects a zone of `ZONE_SD`, weighing as much as one or two events. Clutter is uniform
over the image, so its evidence is 1 (log 0) whatever its size: the number compared against. A group
of one event has exactly that, too: a single event never makes a zone.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaln

from camtopod.arrays import Floats

ZONE_SD = 0.02
"""Image units: the spread a zone is expected to have before anything is seen; from a third to
thrice costs little."""
_FREEDOM = 4.0
_SCALE = 5 * ZONE_SD**2
SHARE_PRIOR = 1.0
"""Dirichlet prior of the zones' shares of the traffic."""


def moments(groups: Floats) -> tuple[Floats, Floats]:
    """Mean (2, ...) of each group and its sums of squared deviations from it (3: xx, xy, yy,
    ...).
    """
    mean = groups[1:3] / np.maximum(groups[0], 1e-12)
    (sx, sy), (x, y) = groups[1:3], mean
    return mean, groups[3:] - np.array((sx * x, sx * y, sy * y))


def gaussians(groups: Floats) -> tuple[Floats, Floats]:
    """Mean (2, ...) and covariance (3: xx, xy, yy, ...) of each group, the prior weighed in."""
    mean, scatter = moments(groups)
    return mean, covariance(groups[0], scatter)


def covariance(n: Floats, scatter: Floats) -> Floats:
    """That of `gaussians` from the number of events and the squared deviations (`moments`)."""
    xx, xy, yy = scatter
    cov: Floats = np.array((xx + _SCALE, xy, yy + _SCALE)) / (n + (_FREEDOM - 1))
    return cov


def log_evidence(groups: Floats) -> Floats:
    """Log marginal likelihood of each group as one zone, relative to clutter."""
    n = np.maximum(groups[0], 1.0)
    xx, xy, yy = moments(groups)[1]
    half = 0.5 * (_FREEDOM + n - 1)
    determinant = (_SCALE + xx) * (_SCALE + yy) - xy * xy
    result: Floats = (
        _log_gamma_2(half)
        + _CONSTANT
        - (n - 1) * np.log(np.pi)
        - np.log(n)
        - half * np.log(determinant)
    )
    return result


def log_zone(n: Floats, scatter: Floats) -> Floats:
    """`log_evidence` and `log_share` of groups together, by number of events and squared deviations
    (`moments`).

    By the duplication formula all their gamma functions are powers of two times the same factorial,
    `_FREEDOM` and `SHARE_PRIOR` being what they are.
    """
    factorial = gammaln(n + 1)
    n = np.maximum(n, 1.0)
    xx, xy, yy = scatter
    determinant = (xx + _SCALE) * (yy + _SCALE) - xy * xy
    result: Floats = (
        factorial + np.maximum(factorial, 0.0) + np.log((n + 1) / n) - n * _LOG_TAU + _BOTH
    )
    result -= (0.5 * (_FREEDOM - 1) + 0.5 * n) * np.log(determinant)
    return result


def log_share(n: Floats) -> Floats:
    """A zone's term in the log prior of the partition, see `log_zones`."""
    result: Floats = gammaln(n + SHARE_PRIOR) - gammaln(SHARE_PRIOR)
    return result


def log_zones(zones: int, total: Floats) -> Floats:
    """Log prior of ``total`` events' partition into so many zones and clutter, but for the terms of
    the zones (`log_share`) and of the clutter (log of its factorial): a Dirichlet multinomial over
    unordered zones.
    """
    weight = SHARE_PRIOR * zones + 1
    result: Floats = gammaln(zones + 1) + gammaln(weight) - gammaln(total + weight)
    return result


def _log_gamma_2(a: Floats) -> Floats:
    """Log of the bivariate gamma function."""
    result: Floats = 0.5 * np.log(np.pi) + gammaln(a) + gammaln(a - 0.5)
    return result


_CONSTANT = _FREEDOM * np.log(_SCALE) - _log_gamma_2(np.array(_FREEDOM / 2))
_BOTH = _CONSTANT + np.log(np.pi**2 / 2)
_LOG_TAU = float(np.log(2 * np.pi))
