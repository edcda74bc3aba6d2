"""Quantiles of masses over lag bins, and the share of the bins that is not known yet."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from camtopod.predict.time_windows import WINDOW, quantiles, unknown_share

EDGES = np.array([-2.0, -0.5, 0.0, 1.0, 3.0, 7.0])
MASSES = st.lists(st.floats(0.01, 1), min_size=5, max_size=5)


@given(st.lists(MASSES, min_size=1, max_size=4))
def test_quantiles_are_those_of_interpolation(masses: list[list[float]]) -> None:
    found = quantiles(np.array(masses), EDGES)
    for row, mass in zip(found, masses, strict=True):
        below = np.array([0.0, *np.cumsum(mass)])
        assert row == pytest.approx(np.interp(np.array(WINDOW) * below[-1], below, EDGES))


@given(st.floats(0.01, 9), st.floats(-9, 9), st.floats(-3, 3))
def test_the_unknown_share_is_that_of_fine_steps(
    elapsed: float, remembered: float, shift: float
) -> None:
    [found] = unknown_share(EDGES, elapsed, remembered, np.array([shift]))
    for low, high, share in zip(EDGES, EDGES[1:], found, strict=False):
        reported = np.linspace(low, high, 2001) + shift
        is_unknown = (reported > elapsed) | ((reported > 0) & (reported < remembered))
        assert share == pytest.approx(is_unknown.mean(), abs=2e-3)
