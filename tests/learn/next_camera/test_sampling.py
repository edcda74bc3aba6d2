"""Samples of correspondences, and their effect on predictions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from prediction_quality import prediction_quality

from bench.support.regimes import REGIMES
from camtopod.learn import refit
from camtopod.learn.next_camera import fit as module
from camtopod.learn.next_camera.sampling import FAINT_TRANSITIONS, Sources, add_prior_transitions
from camtopod.topology.lag_bins import LagBins

BINS = LagBins(-10.0, 30.0)


@given(st.integers(0, 10**6), st.integers(0, 30), st.integers(1, 12))
@settings(max_examples=60)
def test_an_arrival_has_one_source_at_most(seed: int, candidates: int, arrivals: int) -> None:
    rng = np.random.default_rng(seed)
    arrival = np.sort(rng.integers(0, arrivals, candidates)).astype(np.int32)
    weight = rng.random(candidates)
    responsibility = (
        weight / np.maximum(np.bincount(arrival, weight, arrivals), 1e-9)[arrival] * rng.random()
    )
    drawn = np.flatnonzero(Sources(arrival, arrivals, seed).draw(responsibility))
    assert np.bincount(arrival[drawn], minlength=arrivals).max() <= 1


def test_as_often_as_likely() -> None:
    arrival = np.array([0, 0, 1, 2, 2], np.int32)
    responsibility = np.array([0.2, 0.8, 0.3, 0.0, 0.5])
    sources = Sources(arrival, 4, 7)
    mean = np.mean([sources.draw(responsibility) for _ in range(4000)], axis=0)
    assert mean == pytest.approx(responsibility, abs=0.03)
    assert mean[3] == 0.0


def test_faint_transitions_are_spread_over_later_lags() -> None:
    source = np.array([0, 0, 1], np.int32)
    hazard, exposed = np.full((3, BINS.size), 0.02, np.float32), np.full((2, BINS.size), 40.0)
    mixed = add_prior_transitions(hazard.copy(), exposed, source, BINS)
    before = BINS.edges[1:] <= 0
    assert mixed[0, before] == pytest.approx(0.02 * 40 / (40 + 2 * FAINT_TRANSITIONS))
    assert mixed[2, before] == pytest.approx(0.02 * 40 / (40 + FAINT_TRANSITIONS))
    alone = add_prior_transitions(np.zeros_like(hazard), exposed, source, BINS)
    assert (alone * BINS.widths)[2].sum() * (40 + FAINT_TRANSITIONS) == pytest.approx(
        FAINT_TRANSITIONS
    )
    assert mixed == pytest.approx(alone + mixed[:, :1])


# --- what it is for ---


def test_little_is_not_taken_for_more_than_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """On the walkway, with a few hundred events, predictions with samples are less overconfident;
    without the second opinion, which gains as much.
    """
    monkeypatch.setattr(refit, "is_wanted", lambda scene, cameras: False)
    networks = [REGIMES["walkway"].make(seed) for seed in range(20, 24)]
    sampled = np.mean([prediction_quality(*network)["log_loss"] for network in networks])
    monkeypatch.setattr(module.PosteriorFitter, "sample", lambda self: None)
    fitted = np.mean([prediction_quality(*network)["log_loss"] for network in networks])
    assert sampled < fitted - 0.1
