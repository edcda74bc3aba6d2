"""The thesis's link test: variance of Mahalanobis distances between times at two zones.

See table 4.3 and eq. 4.3-4.4: two zones are linked if ``Var(d) <= 1``. The thesis takes S from the
linked pairs themselves; then the test holds for any pair (its experiment 1 links all 28 pairs).
Here S is the variance of lags under the null model, over the range of lags looked at. Unrelated
zones then have ``Var(d)`` near 1, and a link has less, the narrower its transit times are spread.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats

LINKED_VARIANCE_MAX = 1.0
"""Largest ``Var(d)`` of a link (table 4.3)."""


def null_variance(lag_min: float, lag_max: float) -> float:
    """Return the variance (s^2) of lags spread evenly over the range looked at."""
    return (lag_max - lag_min) ** 2 / 12.0


def distance(left: Floats, came: Floats, variance: float) -> Floats:
    """Return the Mahalanobis distances (n,) of arrivals from departures, with the sign of the lag.

    left, came (n,): times of departure and arrival, seconds.
    variance (s^2): S of the thesis.
    """
    d: Floats = (came - left) / np.sqrt(variance)
    return d


def distance_variance(lags: Floats, variance: float) -> Floats:
    """Return ``Var(d)`` (L,) of each link from its (Monte Carlo) lags (L, n) in seconds."""
    result: Floats = distance(np.zeros_like(lags), lags, variance).var(axis=1)
    return result
