"""Bins of lags: those of many lags at once are those of each."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st

from camtopod.topology import lag_bins
from camtopod.topology.lag_bins import LagBins


@given(
    st.floats(-600.0, 100.0),
    st.floats(0.01, 900.0),
    st.sampled_from([(4.0, 0.1), (0.5, 0.3), (4.0, 1.5)]),
    st.integers(0, 10**6),
)
def test_bins_of_many_lags_are_those_of_each(
    lag_min: float, length: float, shape: tuple[float, float], seed: int
) -> None:
    """Also at the edges, one float beside them, and without bounds; in single precision, too."""
    bins = LagBins(lag_min, lag_min + length, *shape)
    anywhere = np.random.default_rng(seed).uniform(lag_min - 5.0, bins.lag_max + 5.0, 300)
    edges = np.concatenate((bins.edges, bins.limits))
    beside = (np.nextafter(edges, side) for side in (-np.inf, np.inf))
    lags = np.concatenate((anywhere, edges, *beside, [np.inf, -np.inf]))
    for some in (lags, lags.astype(np.float32)):
        assert bins.index(some).tolist() == [bins.bin_of(float(lag)) for lag in some]


def test_lags_are_looked_up_in_parts_of_any_shape() -> None:
    bins = LagBins(-60.0, 180.0)
    lags = np.linspace(-70.0, 190.0, 2 * lag_bins.LAGS_AT_ONCE + 2).reshape(2, -1)
    assert bins.index(lags).tolist() == [[bins.bin_of(lag) for lag in row] for row in lags.tolist()]
