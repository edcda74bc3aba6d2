"""Figures of predictions for the last part of a recording, learned from its first part."""

from __future__ import annotations

from bench.support.measure import TRAIN_SHARE, predict, prediction_figures
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.records import Event
from camtopod.sim.truth import Truth


def prediction_quality(events: list[Event], truth: Truth) -> dict[str, float]:
    """Return the figures of one batch fit."""
    learner = Learner(Settings(refit_share=1e9, refit_hours=1e9))
    for event in events[: int(TRAIN_SHARE * len(events))]:
        learner.receive(event)
    learner.flush()
    assert learner.topology is not None
    return prediction_figures(predict(learner.topology, events), events, truth)
