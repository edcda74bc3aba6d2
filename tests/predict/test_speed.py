"""Time windows for objects of known and unknown speed."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from bench.support.prediction_scores import next_entries
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.predict.predictor import Predictor
from camtopod.sim.simulation import SimSettings, simulate


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
                    n.q10 <= lag <= n.q90 for n in predictor.predict(event).next if n.zone == zone
                ]
            predictor.observe(event)
        shares.append(float(np.mean(inside)))
    assert 0.68 < shares[0] < 0.9
    assert shares[1] < shares[0] - 0.05, "without the pace they hold less"
