"""The thesis's link test: variance of Mahalanobis distances between times at two zones.

The distance of a departure at time t_u and an arrival at time t_v is ``d = (t_v - t_u) / sqrt(S)``.
Two zones are linked if ``Var(d) <= 1`` over their transitions (table 4.3, eq. 4.3, 4.4). The thesis
takes S from the linked pairs themselves; then the test accepts any pair of zones (its experiment 1
links all 28 pairs). Here S is the variance of lags under the null model, over the range of lags in
use. Unrelated zones then have ``Var(d)`` near 1, and linked zones less, the less the narrower their
transit times are spread.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats

LINKED_VARIANCE_MAX = 1.0
"""Largest ``Var(d)`` of a link (table 4.3)."""


def null_variance(lag_min: float, lag_max: float) -> float:
    """Return the variance (s^2) of lags spread evenly from ``lag_min`` to ``lag_max`` (seconds)."""
    return (lag_max - lag_min) ** 2 / 12.0


def distance_variance(lags: Floats, variance: float) -> Floats:
    """Return the thesis's ``Var(d)`` of L links, (L,).

    lags (L, n, seconds): n lags of each link, observed or Monte Carlo.
    variance (s^2): S of the thesis.
    """
    result: Floats = (lags / np.sqrt(variance)).var(axis=1)
    return result
