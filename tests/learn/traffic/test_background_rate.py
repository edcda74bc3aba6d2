"""Lag bins, smoothing, local rates and null model rates against their definitions."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from camtopod.learn.traffic.background_rate import (
    CHANCE_BIN_SECONDS,
    RATE_HALF_WINDOW_SECONDS,
    RATE_PRIOR_EVENTS,
    NullRates,
    local_rates,
)
from camtopod.topology.lag_bins import LAG_SCALE_SECONDS, LAG_STEP, LagBins, lag_smoothing_matrix

BINS = LagBins(-20.0, 120.0)


@given(st.floats(-30, 150))
def test_bin_of_a_lag(lag: float) -> None:
    (k,) = BINS.index(np.array([lag]))
    assert k == naive.lag_bin(lag, -20.0, 120.0, LAG_SCALE_SECONDS, LAG_STEP)
    if k < 0:
        assert lag < -20 or lag > 120
    else:
        slack = 1e-9 * max(abs(lag), 1)
        assert BINS.edges[k] - slack <= lag <= BINS.edges[k + 1] + slack


@given(
    st.integers(-300_000_000, 10_000_000),
    st.floats(0.01, 400),
    st.floats(0.5, 20),
    st.floats(0.02, 0.5),
)
@example(-1, 1.0, 2.0, 0.5)
def test_bins_cover_their_range(
    microseconds: int, length: float, scale: float, step: float
) -> None:
    low = (
        microseconds / 1e6
    )  # as times are kept: a lag of 5e-324 s, which hypothesis finds, has bin 0
    bins = LagBins(low, low + length, scale, step)
    assert bins.index(np.array([low, low + length])).tolist() == [0, bins.size - 1]
    assert len(bins.widths) == len(bins.centres) == bins.size == len(bins.edges) - 1
    assert (bins.widths > 0).all()
    assert ((bins.edges[:-1] < bins.centres) & (bins.centres < bins.edges[1:])).all()
    assert bins.edges[0] <= low + 1e-9 * abs(low)
    assert bins.edges[-1] >= low + length - 1e-9 * abs(low + length)


@pytest.mark.parametrize(("low", "high"), [(1.0, 1.0), (2.0, 1.0), (float("nan"), 1.0)])
def test_an_empty_range_is_refused(low: float, high: float) -> None:
    with pytest.raises(ValueError, match="lag range is empty"):
        LagBins(low, high)


@pytest.mark.parametrize("sd_bins", [0.7, 1.2, 6.0])
def test_smoother_equals_its_slow_twin_and_keeps_mass(sd_bins: float) -> None:
    spread = lag_smoothing_matrix(17, sd_bins)
    assert spread == pytest.approx(naive.smoothing_kernel(17, sd_bins))
    assert spread.sum(axis=0) == pytest.approx(1.0)


def traffic(seed: int, n: int, zones: int, span: float = 5000.0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return np.sort(rng.uniform(0, span, n)), rng.integers(0, zones, n).astype(np.int32)


@given(
    st.integers(0, 10**6),
    st.integers(1, 40),
    st.integers(1, 4),
    st.sampled_from([3.0, 900.0, 9000.0]),
)
def test_local_rates_equal_their_slow_twin(seed: int, n: int, zones: int, span: float) -> None:
    t, zone = traffic(seed, n, zones, span)
    slow = naive.local_rates(t, zone, RATE_HALF_WINDOW_SECONDS, RATE_PRIOR_EVENTS)
    assert local_rates(t, zone, zones) == pytest.approx(slow)
    assert (local_rates(t, zone, zones) > 0).all()


@given(
    st.integers(0, 10**6),
    st.integers(1, 25),
    st.integers(1, 25),
    st.sampled_from([30.0, 900.0, 9000.0]),
)
def test_chance_equals_its_slow_twin(seed: int, n: int, m: int, span: float) -> None:
    left, came = traffic(seed, n, 3, span), traffic(seed + 1, m, 3, span)
    slow = naive.chance_rates(*left, *came, 3, CHANCE_BIN_SECONDS)
    source, target = np.repeat(np.arange(3), 3), np.tile(np.arange(3), 3)
    found = NullRates(*left, *came, 3)
    assert found.rates_of(source, target) == pytest.approx(slow.ravel())
    assert found.rates_of(target, source) == pytest.approx(slow.T.ravel())
    assert found.rates_to(np.array([2, 0])) == pytest.approx(slow[:, [2, 0]], rel=1e-5)
    assert len(found.rates_of(source[:0], target[:0])) == 0
