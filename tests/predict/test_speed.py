"""Time windows for objects of known and unknown speed."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from bench.support.prediction_scores import next_entries
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.predict.predictor import Predictor
from camtopod.predict.speed import PaceModel, windows_at_pace
from camtopod.records import Camera, Model, Pace, Topology, Way, Zone
from camtopod.sim.simulation import SimSettings, simulate

ZONES = [Zone("a/1", "a", 9, 9), Zone("a/2", "a", 9, 9)]


def paces(pace: Pace | None) -> PaceModel:
    model = Model(4.0, 0.1, -20.0, 120.0, [], [], pace=pace)
    cameras = [Camera("a", ["a/1", "a/2"])]
    return PaceModel(
        Topology(
            "camtopod/topology/1", "s", "e", 1, 0.0, 9, "", cameras, ZONES, [], [], model=model
        )
    )


def window(
    site: PaceModel,
    entry: int | None,
    exit_: int,
    dwell: float | None,
    transitions: float,
    *lags: float,
) -> list[float]:
    """The window after one passage."""
    pace = site.of_passage(entry, exit_, dwell)
    return windows_at_pace(pace, np.array([lags]), np.array([transitions]))[0].tolist()


def test_who_took_twice_as_long_is_expected_later() -> None:
    site = paces(Pace(1.0, 0.6, 0.3, [Way("a/1", "a/2", 5.0)]))
    usual, slow = (window(site, 0, 1, stay, 100.0, 8.0, 10.0, 12.0) for stay in (5.0, 10.0))

    assert usual[1] == pytest.approx(10.0)
    # The next view's slowness is expected to be 0.6 of this one's.
    assert slow[1] == pytest.approx(10.0 * 2**0.8)
    assert [late / early for late, early in zip(slow, usual, strict=True)] == pytest.approx(
        [2**0.8] * 3
    )


def test_an_unknown_pace_widens_the_window() -> None:
    site = paces(Pace(1.0, 0.6, 0.3, [Way("a/1", "a/2", 5.0)]))
    known = window(site, 0, 1, 5.0, 100.0, 8.0, 10.0, 12.0)
    for entry, stay in ((None, None), (1, 5.0), (0, None)):
        unknown = window(site, entry, 1, stay, 100.0, 8.0, 10.0, 12.0)
        assert unknown[0] < known[0] < unknown[1] < known[2] < unknown[2]


def test_windows_hold_what_they_say() -> None:
    """Of the true next entries in view of the named zone, 80 % should lie between q10 and q90."""
    events, truth = simulate(SimSettings(cameras=6, hours=0.8, seed=3, missed=0.05, clutter=0.05))
    cut, following = int(0.7 * len(events)), next_entries(events, truth)
    learner = Learner(Settings(refit_share=1e9, refit_hours=1e9))
    for event in events[:cut]:
        learner.receive(event)
    learner.flush()

    assert learner.topology is not None
    model = learner.topology.model
    assert model is not None
    assert model.pace is not None
    shares = []
    for topology in (learner.topology, replace(learner.topology, model=replace(model, pace=None))):
        predictor, inside = Predictor(topology), []
        for index, event in enumerate(events):
            if index >= cut and event.kind == "exit" and following[index] >= 0:
                entry = events[following[index]]
                zone = predictor.zones[predictor.zone_of(entry) or 0].id
                lag = entry.t - event.t
                inside += [
                    n.q10 <= lag <= n.q90 for n in predictor.predict(event).next_ if n.zone == zone
                ]
            predictor.observe(event)
        shares.append(float(np.mean(inside)))
    assert 0.72 < shares[0] < 0.9
    assert shares[1] < shares[0] - 0.05, "without the pace they hold less"
