"""The thesis's link test: the variance of Mahalanobis distances between times at two zones (table
4.3, eq. 4.3-4.4).

Two zones are linked when ``Var(d) <= 1``. With S taken from the linked pairs themselves, as the
thesis does, that holds for everything (its experiment 1 links all 28 pairs). Here S is the variance
of lags at chance, over the range of lags looked at: unrelated zones then have ``Var(d)`` near 1,
and a link has less the better its transit time is kept.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats

LINKED_VARIANCE_MAX = 1.0


def chance_variance(lag_min: float, lag_max: float) -> float:
    """Variance (s^2) of lags spread evenly over the range looked at."""
    return (lag_max - lag_min) ** 2 / 12.0


def distance(left: Floats, came: Floats, variance: float) -> Floats:
    """Mahalanobis distance between times of departure and arrival, (n,) each; signed, for
    overlapping views.
    """
    d: Floats = (came - left) / np.sqrt(variance)
    return d


def distance_variance(lags: Floats, variance: float) -> Floats:
    """``Var(d)`` of each link from its (Monte Carlo) observations (L, n) in seconds."""
    result: Floats = distance(np.zeros_like(lags), lags, variance).var(axis=1)
    return result
