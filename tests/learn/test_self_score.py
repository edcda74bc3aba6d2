"""The learner's scores of its own predictions, compared with scores by the ground truth."""

from __future__ import annotations

import math

import pytest

from bench.support.prediction_scores import next_entries
from camtopod.learn.learner import Learner
from camtopod.learn.outcomes import ScoredPrediction
from camtopod.learn.prediction_model import SHARE_MIN
from camtopod.learn.self_score import (
    EXITS_PER_VERSION,
    SCORED_MAX,
    Scorer,
    ScorerState,
    marks,
)
from camtopod.learn.settings import Settings
from camtopod.records import Event, SelfScore
from camtopod.sim.settings import SimSettings
from camtopod.sim.simulation import simulate

GUESS = ScoredPrediction(
    0.0, "a", 3, {"": 0.2, "b": 0.5, "c": 0.2, "d": 0.06, "e": 0.04}, {"": 0.3, "c": 0.7}
)


def test_a_plain_outcome_is_marked_as_it_is() -> None:
    mark = marks(GUESS, {"b": 1.0})
    assert (mark.return_probability, mark.top1, mark.top3, mark.baseline_top1) == (
        1.0,
        1.0,
        1.0,
        0.0,
    )
    assert mark.loss == pytest.approx(-math.log(0.5))
    assert mark.baseline_loss == pytest.approx(-math.log(SHARE_MIN))


def test_a_doubtful_outcome_counts_in_parts() -> None:
    mark = marks(GUESS, {"b": 0.5, "e": 0.3})
    assert (mark.return_probability, mark.top1, mark.top3) == (0.8, 0.5, 0.5)
    assert mark.loss == pytest.approx(
        -0.5 * math.log(0.5) - 0.3 * math.log(0.04) - 0.2 * math.log(0.2)
    )


def test_the_score_is_over_the_newest() -> None:
    scorer = Scorer(ScorerState(), None)
    assert scorer.score() is None
    for version in range(2 * SCORED_MAX):
        scorer.note(
            GUESS._replace(version=version), {"b": 1.0} if version >= SCORED_MAX else {"c": 1.0}
        )
    score = scorer.score()
    assert score is not None
    assert (score.exits, score.since_version, score.top1, score.baseline_top1) == (
        SCORED_MAX,
        SCORED_MAX,
        1.0,
        0.0,
    )


class Told(Scorer):
    """A scorer that also scores by the ground truth."""

    def __init__(self, learner: Learner, truth: dict[tuple[float, str], str | None]) -> None:
        super().__init__(learner.state.scorer, None)
        self.truth = truth
        self.told = Scorer(ScorerState(), None)

    def note(self, guess: ScoredPrediction, happened: dict[str, float]) -> None:
        super().note(guess, happened)
        camera = self.truth[round(guess.t, 6), guess.camera]
        self.told.note(guess, {camera: 1.0} if camera else {})


@pytest.fixture(scope="module")
def marked() -> tuple[list[Event], Learner, Told]:
    events, truth = simulate(
        SimSettings(
            cameras=5, hours=0.8, seed=4, missed=0.05, clutter=0.05, objects_per_second=0.06
        )
    )
    following = next_entries(events, truth)
    learner = Learner(Settings(refit_share=0.5))
    told = Told(
        learner,
        {
            (round(event.t, 6), event.camera): None if entry < 0 else events[entry].camera
            for event, entry in zip(events, following, strict=True)
            if event.kind == "exit"
        },
    )
    learner._scorer = told
    for event in events:
        learner.receive(event)
    learner.flush()
    return events, learner, told


def scores(told: Told) -> tuple[SelfScore, SelfScore]:
    ours, true = told.score(), told.told.score()
    assert ours is not None
    assert true is not None
    return ours, true


def test_the_marks_are_near_the_truth(marked: tuple[list[Event], Learner, Told]) -> None:
    ours, true = scores(marked[2])
    assert ours.exits > 300
    assert ours.top1 == pytest.approx(true.top1, abs=0.06)
    assert ours.top3 == pytest.approx(true.top3, abs=0.08)
    assert ours.log_loss == pytest.approx(true.log_loss, abs=0.3)
    assert ours.top1 > ours.baseline_top1 + 0.05
    assert true.top1 > true.baseline_top1 + 0.05


def test_a_version_publishes_the_score(marked: tuple[list[Event], Learner, Told]) -> None:
    _, learner, told = marked
    made = learner.updates()
    assert made[0].score is None  # nothing had been said yet
    assert made[-1].score == told.score()
    assert made[-1].score is not None
    assert made[-1].score.exits <= EXITS_PER_VERSION * 2 * len(made)
