"""Spurious transitions in the posterior: unusual pairs, and everything where nothing is linked."""

from __future__ import annotations

import numpy as np
import pytest

from camtopod.learn.learner import Learner
from camtopod.learn.next_camera.spurious import (
    any_link_probability,
    real_probability,
    spurious_shares,
)
from camtopod.learn.settings import Settings
from camtopod.records import Event, Prediction, Topology
from camtopod.sim.settings import SimSettings
from camtopod.sim.simulation import simulate

NO_RETURNS = np.zeros(4, np.bool_)
ONCE = Settings(refit_share=1e9, refit_hours=1e9)
"""Everything is learned in one fit."""


def test_what_is_usual_is_not_doubted_and_what_is_out_of_character_is() -> None:
    real = real_probability(
        np.array([4.0, 5.0, 6.0, 2.0, 0.1]),
        np.array([100.0, 100.0, 100.0, 5.0, 5.0]),
        np.zeros(5),
        np.zeros(5, np.bool_),
    )
    assert real[1:3] == pytest.approx([1.0, 1.0])
    assert real[0] > 0.95
    assert 0.7 < real[3] < 0.95
    assert real[4] < 0.02


def test_a_wide_path_through_heavy_traffic_is_real_by_its_held_out_evidence() -> None:
    """Its transitions are many, with little evidence each; evidence against it adds no doubt."""
    each, transitions = np.array([4.0, 0.2, 0.2, 0.2]), np.array([900.0, 50.0, 50.0, 50.0])
    real = real_probability(each, transitions, np.array([50.0, -9.0, 0.0, 20.0]), NO_RETURNS)
    assert real[1] == real[2] < 0.05
    assert real[3] == pytest.approx(1.0)


def test_a_path_back_into_the_same_view_has_to_earn_it() -> None:
    each, transitions = np.full(3, 4.0), np.full(3, 100.0)
    returns = np.array([False, True, True])
    real = real_probability(each, transitions, np.array([0.0, 0.0, 3.0]), returns)
    assert real[0] == pytest.approx(1.0)
    assert real[1] < 0.7
    assert real[2] == pytest.approx(1.0)


def test_whether_anything_is_linked_takes_evidence_or_departures_to_tell() -> None:
    few, many = np.zeros(10), np.full(10, 500.0)
    assert any_link_probability(np.zeros(0), few) == pytest.approx(0.5)
    assert any_link_probability(np.zeros(0), many) < 1e-9
    assert any_link_probability(np.array([np.log(100.0)]), many) == pytest.approx(0.5)
    assert any_link_probability(np.array([-20.0, 60.0]), many) == pytest.approx(1.0)
    assert spurious_shares(
        np.zeros(0, np.int32), np.zeros(0), np.zeros(2), 0.8, np.zeros(2, np.bool_)
    ) == pytest.approx([0.2, 0.2])


# --- what comes of it ---


def said(events: list[Event], settings: Settings = ONCE) -> tuple[Topology, list[Prediction]]:
    """Return the learned topology and its prediction for each exit, without observing events."""
    learner = Learner(settings)
    for event in events:
        learner.receive(event)
    learner.flush()
    assert learner.topology is not None
    predictor = learner.predictor()
    return learner.topology, [predictor.predict(event) for event in events if event.kind == "exit"]


@pytest.mark.parametrize("seconds", [8.0, 100.0])
def test_who_always_comes_is_foretold_as_surely_as_is_published(seconds: float) -> None:
    """The spurious share does not depend on the length of the path."""
    rng = np.random.default_rng(3)
    events = []
    for t in np.sort(rng.uniform(0, 40_000, 400)):
        came = t + seconds + rng.normal(0, 0.05 * seconds)
        events += [
            Event("a", "exit", float(t), 0.8, 0.5),
            Event("b", "entry", float(came), 0.2, 0.5),
        ]
    topology, predictions = said(sorted(events, key=lambda event: event.t))
    (link,) = topology.links
    assert link.probability > 0.9
    assert np.mean([p.next[0].probability for p in predictions]) == pytest.approx(
        link.probability, abs=0.1
    )


def test_where_nothing_is_linked_objects_are_foretold_to_leave() -> None:
    events, _ = simulate(SimSettings(cameras=8, hours=2.0, seed=1, linked=False, rhythm=0.9))
    topology, predictions = said(events)
    assert not [link for link in topology.links if link.relation != "visible"]
    assert np.mean([prediction.leave for prediction in predictions]) > 0.5
