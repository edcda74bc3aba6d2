"""Evidence and false discovery rates."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given, strategies as st

from camtopod.learn.links.significance import (
    expected_by_part,
    log_likelihood_ratio,
    q_values,
    repeated_evidence,
)

RATIOS = st.lists(st.one_of(st.floats(-5, 40), st.sampled_from([0.0, 3.0])), max_size=25)


@given(RATIOS, st.integers(0, 100))
def test_q_values_by_their_definition(ratios: list[float], further: int) -> None:
    ratio = np.array(ratios)
    tests = len(ratios) + further
    assert q_values(ratio, tests) == pytest.approx(
        naive.q_values(np.minimum(np.exp(-ratio), 1), max(tests, 1))
    )


@given(st.integers(0, 10**6), st.integers(0, 50))
def test_ratio_by_loops(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    pair, share, flat = (
        rng.integers(0, 4, n).astype(np.int32),
        rng.random(n),
        np.exp(rng.normal(0, 2, n)),
    )
    found = log_likelihood_ratio(pair, share, flat, 4)
    for p in range(4):
        rows = [k for k in range(n) if pair[k] == p]
        unrelated = sum(-np.log(1 - share[k]) - share[k] for k in rows)
        untimed = sum(-np.log(1 - share[k] + share[k] * flat[k]) for k in rows)
        assert found[p] == pytest.approx(min(unrelated, untimed))


def test_one_occasion_tells_no_more_than_a_third_of_all_others() -> None:
    """Twelve transitions at once count as none, or against it; twelve over the window count in full."""
    share, flat = np.full(12, 0.9), np.full(12, 0.01)
    pair = np.zeros(12, np.int32)
    zone, left = np.zeros(64, np.int32), np.linspace(0.0, 1.0, 64)
    expected = expected_by_part(np.array([12 * 0.9]), pair[:1], zone, left)
    assert expected.sum() == pytest.approx(12 * 0.9)
    all_of_it = log_likelihood_ratio(pair, share, flat, 1)
    together, spread = (
        [repeated_evidence(pair, share, flat, at, 1, rate) for rate in (None, expected)]
        for at in (np.full(12, 0.3), np.linspace(0.0, 1.0, 12))
    )
    assert together[0] == pytest.approx(0.0)
    assert together[1] < -5.0
    assert spread[0] == pytest.approx(all_of_it)
    assert spread[1] == pytest.approx(all_of_it)
