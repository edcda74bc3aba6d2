"""Labels of objects: how far they persist, and what they tell about who is who."""

from __future__ import annotations

from dataclasses import dataclass

import naive
import numpy as np
import pytest
from model_rows import rows_of
from msgspec.structs import replace

from camtopod.learn.association import adjust, find_candidates, fit_jointly
from camtopod.learn.association.problem import Problem
from camtopod.learn.learner import Learner
from camtopod.learn.paths.camera_lags import camera_lags
from camtopod.learn.traffic import (
    NO_PERSISTENCE,
    Arrivals,
    Departures,
    estimate_label_persistence,
    label_agreement,
    label_shares,
    local_rates,
)
from camtopod.learn.traffic.labels import (
    PERSISTENCE_MAX,
    PRIOR_TRANSITIONS,
    ZONE_ARRIVALS,
    first_weights,
)
from camtopod.records import Event
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.topology import LagBins

SHARES = {"car": 0.8, "van": 0.12, "bus": 0.08}


def test_shares_and_agreement_equal_their_slow_twins() -> None:
    rng = np.random.default_rng(0)
    zone, label, left = rng.integers(0, 3, 80), rng.integers(-1, 4, 80), rng.integers(-1, 4, 80)

    share = label_shares(zone, label, 3)

    assert share == pytest.approx(naive.label_shares(zone, label, ZONE_ARRIVALS))
    for persistence in (0.0, 0.4, 0.99):
        ratio = label_agreement(left, label, share, persistence)
        assert ratio == pytest.approx(naive.label_agreement(left, label, share, persistence))
    assert label_agreement(left, label, share, 0.0).tolist() == [1.0] * 80


@pytest.mark.parametrize("errs", [0.0, 0.1, 1.0])
def test_persistence_is_the_likeliest(errs: float) -> None:
    """Also where three in ten candidates are of two objects."""
    rng = np.random.default_rng(1)
    chance = np.array([*SHARES.values()])
    left, other = rng.choice(3, (2, 4000), p=chance)
    is_one = rng.random(4000) < 0.7
    came = np.where(is_one & (rng.random(4000) >= errs), left, other)
    given = left == came, chance[came], np.full(4000, 0.7)

    found = estimate_label_persistence(*given)

    twin = naive.label_persistence(*given, *PRIOR_TRANSITIONS)
    assert found == pytest.approx(min(twin, PERSISTENCE_MAX), abs=0.003)
    assert found == pytest.approx(1.0 - errs, abs=0.05)


def test_a_transition_weighs_one_and_chance_less() -> None:
    rng = np.random.default_rng(2)
    chance = np.array([*SHARES.values()])
    left, other = rng.choice(3, (2, 50_000), p=chance)
    share = chance[other]

    one, two = (
        first_weights(label_agreement(left, came, chance[came], 0.9).astype(np.float32), share, 0.9)
        for came in (np.where(rng.random(50_000) < 0.9, left, other), other)
    )

    assert one[0].mean() == pytest.approx(1.0, abs=0.03)
    assert two[0].mean() == pytest.approx(two[1], rel=0.05)
    assert two[1] < 0.5


@dataclass
class Crowd:
    """Objects on one path of 20 to 60 s, where many are on their way at once."""

    departures: Departures
    arrivals: Arrivals
    who: np.ndarray

    def problem(self) -> Problem:
        return Problem(self.departures, self.arrivals, LagBins(0.0, 90.0), 2, 1e9)


def crowd(n: int = 600, label: str = "own") -> Crowd:
    """Draw a crowd; ``label``: own of each object, random in each view, or none."""
    rng = np.random.default_rng(5)
    left = np.sort(rng.uniform(0, 8_000, n))
    came = left + rng.uniform(20, 60, n)
    who = np.argsort(came)
    labels, others = rng.choice(3, (2, n), p=[*SHARES.values()]).astype(np.int32)
    zone = np.zeros(n, np.int32)
    unknown = np.full(n, np.nan)
    t = came[who]
    departures = Departures.without_arrivals(left, zone, zone, left - 5.0, unknown)
    arrivals = Arrivals(t, zone + 1, zone + 1, local_rates(t, zone + 1, 2), unknown)
    if label != "none":
        there = labels[who] if label == "own" else others
        departures = departures._replace(label=labels)
        share = label_shares(zone + 1, there, 2)
        arrivals = arrivals._replace(label=there, label_share=share)
    return Crowd(departures, arrivals, who)


def right(one: Crowd) -> float:
    """Return the mean responsibility of the true transitions."""
    problem = one.problem()
    fit = fit_jointly(problem, find_candidates(problem))
    c = fit.candidates
    return float(fit.responsibility[one.who[c.arrival] == c.departure].sum()) / len(one.who)


def test_labels_tell_who_is_who_and_random_ones_do_no_harm() -> None:
    without, with_own, with_random = (right(crowd(label=how)) for how in ("none", "own", "random"))

    assert with_own > 1.4 * without
    assert with_random == pytest.approx(without, rel=0.15)


def test_candidates_agree_by_label_where_labels_persist() -> None:
    problem = crowd().problem()
    candidates = find_candidates(problem)
    d, a = problem.departures, problem.arrivals
    assert d.label is not None
    assert a.label is not None
    assert a.label_share is not None

    adjusted = adjust(problem, candidates, NO_PERSISTENCE._replace(label=0.9))

    c = candidates
    twin = naive.label_agreement(
        d.label[c.departure], a.label[c.arrival], a.label_share[c.arrival], 0.9
    )
    assert adjusted.agreement == pytest.approx(twin, rel=1e-5)
    assert adjust(problem, candidates, NO_PERSISTENCE).agreement is None


def test_paths_between_cameras_know_labels() -> None:
    one = crowd(60)
    lags = camera_lags(one.departures, one.arrivals, 2, 0.0, 1e9, label_persistence=0.9)
    assert one.departures.label is not None
    assert one.arrivals.label is not None
    assert lags.likeness is not None

    like = one.departures.label[lags.departure] == one.arrivals.label[lags.arrival]
    assert lags.likeness[~like].tolist() == pytest.approx([0.1] * int((~like).sum()))
    assert (lags.likeness[like] > 1.0).all()
    without = camera_lags(one.departures, one.arrivals, 2, 0.0, 1e9)
    assert without.likeness is None


def learned(events: list[Event]) -> Learner:
    learner = Learner(only_last=True)
    for event in events:
        learner.receive(event)
    learner.flush()
    return learner


def test_a_site_learns_how_far_labels_persist() -> None:
    events, _ = simulate(SimSettings(cameras=4, hours=0.5, seed=3, labels={"car": 0.7, "bus": 0.3}))

    topology = learned(events).topology

    assert topology is not None
    labels = rows_of(topology).labels
    assert labels is not None
    assert labels.names == ["bus", "car"]
    assert labels.persistence > 0.9
    assert {len(row) for row in labels.shares.values()} == {2}


def test_labels_that_are_all_the_same_change_nothing() -> None:
    events, _ = simulate(SimSettings(cameras=4, hours=0.3, seed=3))
    same = [replace(event, label="Person") for event in events]

    one, two = (learned(some).topology for some in (events, same))

    assert one is not None
    assert two is not None
    assert one.digest == two.digest
