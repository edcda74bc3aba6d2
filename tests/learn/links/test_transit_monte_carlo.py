"""Transit times, Monte Carlo observations, Mahalanobis distances (thesis 4.3 to 4.5)."""

from __future__ import annotations

import naive
import numpy as np
import pytest
import scipy.stats
from hypothesis import given, strategies as st

from camtopod.learn.association import LIKELY_MIN
from camtopod.learn.links import mahalanobis, monte_carlo
from camtopod.learn.links.transit_time import peak, transit_figures, weighted_quantiles
from camtopod.topology.lag_bins import LagBins

BINS = LagBins(-20.0, 120.0)


def lags(seed: int, n: int, pairs: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pair, lag and weight of n transitions; some have no weight."""
    rng = np.random.default_rng(seed)
    weight = rng.random(n) * (rng.random(n) < 0.8)
    return rng.integers(0, pairs, n).astype(np.int32), rng.uniform(-20, 120, n), weight


def telling(weight: np.ndarray) -> np.ndarray:
    """Return the weights of one pair that count for its quantiles.

    Unlikely transitions count only if there are no others.
    """
    likely = np.where(weight > LIKELY_MIN, weight, 0.0)
    return likely if likely.any() else weight


# --- figures ---


@given(st.integers(0, 10**6), st.integers(0, 60), st.integers(1, 5))
def test_quantiles_equal_those_of_one_pair_at_a_time(seed: int, n: int, pairs: int) -> None:
    pair, lag, weight = lags(seed, n, pairs)
    found = weighted_quantiles(pair, lag, weight, pairs)
    for p in range(pairs):
        x, w = lag[pair == p], telling(weight[pair == p])
        slow = [naive.weighted_quantile(x, w, q) for q in (0.1, 0.5, 0.9)]
        assert found[p] == pytest.approx(slow, nan_ok=True)


@given(st.integers(0, 10**6), st.integers(1, 60), st.integers(1, 5))
def test_figures_equal_their_definitions(seed: int, n: int, pairs: int) -> None:
    pair, lag, weight = lags(seed, n, pairs)
    found = transit_figures(pair, lag, weight, np.zeros((pairs, BINS.size)), BINS)
    for p in range(pairs):
        x, w = lag[pair == p], weight[pair == p]
        assert found.total[p] == pytest.approx(w.sum())
        if w.sum() > 0:
            low, middle, high = (
                naive.weighted_quantile(x, telling(w), q) for q in (0.25, 0.5, 0.75)
            )
            near = abs(x - middle) <= 4.5 * max((high - low) / 1.349, 0.25)
            mean = np.average(x[near], weights=w[near])
            sd = np.sqrt(np.average((x[near] - mean) ** 2, weights=w[near]))
            assert found.mean[p] == pytest.approx(mean)
            assert found.sd[p] == pytest.approx(sd)
            number, sure = w[near].sum(), (w[near] ** 2).sum()
            few = np.sqrt(number / max(number - 1, 0.5))
            assert found.mean_error[p] == pytest.approx(
                np.hypot(max(sd, 0.25) * few / np.sqrt(sure), 0.015 * mean)
            )
            assert found.ahead[p] == pytest.approx(w[x < 0].sum() / w.sum())
            assert found.quantiles[p, 0] <= found.quantiles[p, 1] <= found.quantiles[p, 2]
        else:
            figures = (found.mean[p], found.sd[p], found.ahead[p], *found.quantiles[p])
            assert np.isnan(figures).all()
        assert np.isnan(found.mode[p])


def test_the_median_is_as_sure_as_it_says() -> None:
    pairs, n = 400, 60
    rng = np.random.default_rng(1)
    pair, pace = (
        np.repeat(np.arange(pairs, dtype=np.int32), n),
        0.3 * rng.standard_normal(pairs * n),
    )
    lag = 10.0 * np.exp(pace + 0.1 * rng.standard_normal(pairs * n))
    found = transit_figures(pair, lag, np.ones(len(lag)), np.zeros((pairs, BINS.size)), BINS)
    away = np.abs(found.quantiles[:, 1] - 10.0)
    assert 0.85 < np.mean(away < 1.645 * found.median_error) < 0.99
    mean = 10.0 * np.exp(0.05)
    assert 0.85 < np.mean(np.abs(found.mean - mean) < 1.645 * found.mean_error) < 0.99
    plain = 1.2533 * 0.316 * 10.0 / np.sqrt(n)
    assert np.sqrt(np.mean(away**2)) < 1.1 * plain


@pytest.mark.parametrize("at", [-8.0, -1.0, 0.0, 0.3, 7.8102, 25.0, 90.0])
def test_peak_lies_between_the_bins(at: float) -> None:
    """The peak of a bell three bins wide is found within a fifth of a bin."""
    (k,) = BINS.index(np.array([at]))
    position = np.arcsinh(BINS.edges / BINS.scale) / BINS.step - BINS.first
    middle = np.arcsinh(at / BINS.scale) / BINS.step - BINS.first
    bell = np.exp(-0.5 * ((position[:-1] + 0.5 - middle) / 1.5) ** 2)
    assert peak(bell[None, :], BINS)[0] == pytest.approx(at, abs=0.2 * BINS.widths[k])


# --- Monte Carlo ---


def a_density() -> np.ndarray:
    """Return a density of two unequal humps with a gap between them."""
    shape = np.exp(-0.5 * ((BINS.centres - 5) / 1.5) ** 2)
    return shape + 0.25 * np.exp(-0.5 * ((BINS.centres - 30) / 3) ** 2)


def test_observations_keep_the_density_they_come_from() -> None:
    """The thesis's walk, which accepts every step, does not."""
    density = np.repeat(a_density()[None, :], 60, axis=0)
    found = monte_carlo.observe(density, np.full(60, 2.0), BINS, 1)
    assert found.shape == (60, monte_carlo.OBSERVATIONS)
    mass = density[0] * BINS.widths
    reached = np.concatenate(([0.0], np.cumsum(mass) / mass.sum()))
    distance, _ = scipy.stats.kstest(found.ravel(), lambda x: np.interp(x, BINS.edges, reached))
    assert distance < 0.02
    drifted = found + 2.0 * np.random.default_rng(1).standard_normal(found.shape)
    assert (
        scipy.stats.kstest(drifted.ravel(), lambda x: np.interp(x, BINS.edges, reached))[0] > 0.05
    )


def test_observations_are_repeatable_and_of_nothing_none() -> None:
    density = a_density()[None, :]
    one, again, other = (monte_carlo.observe(density, np.ones(1), BINS, seed) for seed in (1, 1, 2))
    assert (one == again).all()
    assert (one != other).any()
    assert monte_carlo.observe(np.zeros((0, BINS.size)), np.zeros(0), BINS, 1).shape == (0, 89)
    assert np.isfinite(monte_carlo.observe(np.zeros((1, BINS.size)), np.zeros(1), BINS, 1)).all()


# --- Mahalanobis ---


def test_unrelated_zones_are_at_one_and_a_link_far_below() -> None:
    chance = mahalanobis.null_variance(-20.0, 120.0)
    rng = np.random.default_rng(0)
    spread = np.stack([rng.uniform(-20, 120, 5000), rng.normal(8, 2, 5000), np.full(5000, 7.0)])
    found = mahalanobis.distance_variance(spread, chance)
    assert found[0] == pytest.approx(1.0, abs=0.05)
    assert found[1] == pytest.approx(4 / chance, rel=0.1)
    assert found[2] == pytest.approx(0.0)
    assert found[1] < 0.01 < mahalanobis.LINKED_VARIANCE_MAX
