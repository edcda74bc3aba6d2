"""How well what comes after the first part of a recording is prediction_quality by what was learned
of that part.
"""

from __future__ import annotations

from bench.support.measure import TRAIN_SHARE, predict, prediction_figures
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.records import Event
from camtopod.sim.truth import Truth


def prediction_quality(events: list[Event], truth: Truth) -> dict[str, float]:
    """The figures of one batch fit."""
    learner = Learner(Settings(refit_share=1e9, refit_hours=1e9))
    for event in events[: int(TRAIN_SHARE * len(events))]:
        learner.receive(event)
    learner.flush()
    assert learner.topology is not None
    return prediction_figures(predict(learner.topology, events), events, truth)
