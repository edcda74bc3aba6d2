"""Evidence of a group of events being one zone: the marginal likelihood of a Gaussian of unknown mean and
covariance.

A group is six sums (n, Sx, Sy, Sxx, Sxy, Syy) in image units, last axis of every array here; groups add up.
The mean has a flat prior over the image (area 1), the covariance an inverse Wishart prior that expects a zone
of `ZONE_SD`, weighing as much as one or two events. Clutter is uniform over the image, so its evidence is 1
(log 0) whatever its size: the number compared against. A group of one event has exactly that, too: a single
event never makes a zone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

Floats = NDArray[np.float64]

ZONE_SD = 0.02
"""Image units: the spread a zone is expected to have before anything is seen; from a third to thrice costs
little."""
_FREEDOM = 4.0
_SCALE = 5 * ZONE_SD**2
SHARE_PRIOR = 1.0
"""Dirichlet prior of the zones' shares of the traffic."""


def scatter(groups: Floats) -> tuple[Floats, Floats, Floats]:
    """Sums of squared deviations from each group's mean: (xx, xy, yy)."""
    n = np.maximum(groups[..., 0], 1e-12)
    sx, sy = groups[..., 1], groups[..., 2]
    return groups[..., 3] - sx * sx / n, groups[..., 4] - sx * sy / n, groups[..., 5] - sy * sy / n


def gaussians(groups: Floats) -> tuple[Floats, Floats]:
    """Mean (..., 2) and covariance (..., 3: xx, xy, yy) of each group, the prior weighed in."""
    n = groups[..., 0]
    xx, xy, yy = scatter(groups)
    cov = np.stack([xx + _SCALE, xy, yy + _SCALE], axis=-1) / (n + _FREEDOM - 1)[..., None]
    return groups[..., 1:3] / np.maximum(n, 1e-12)[..., None], cov


def log_evidence(groups: Floats) -> Floats:
    """Log marginal likelihood of each group as one zone, relative to clutter."""
    n = np.maximum(groups[..., 0], 1.0)
    xx, xy, yy = scatter(groups)
    half = 0.5 * (_FREEDOM + n - 1)
    determinant = (_SCALE + xx) * (_SCALE + yy) - xy * xy
    result: Floats = _log_gamma_2(half) + _CONSTANT - (n - 1) * np.log(np.pi) - np.log(n) - half * np.log(determinant)
    return result


def log_share(n: Floats) -> Floats:
    """A zone's term in the log prior of the partition, see `log_zones`."""
    result: Floats = gammaln(n + SHARE_PRIOR) - gammaln(SHARE_PRIOR)
    return result


def log_zones(zones: int, total: Floats) -> Floats:
    """Log prior of ``total`` events' partition into so many zones and clutter, but for the terms of the zones
    (`log_share`) and of the clutter (log of its factorial): a Dirichlet multinomial over unordered zones.
    """
    weight = SHARE_PRIOR * zones + 1
    result: Floats = 2 * gammaln(zones + 1) + gammaln(weight) - gammaln(zones + 1) - gammaln(total + weight)
    return result


def _log_gamma_2(a: Floats) -> Floats:
    """Log of the bivariate gamma function."""
    result: Floats = 0.5 * np.log(np.pi) + gammaln(a) + gammaln(a - 0.5)
    return result


_CONSTANT = _FREEDOM * np.log(_SCALE) - _log_gamma_2(np.array(_FREEDOM / 2))
