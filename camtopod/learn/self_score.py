"""Self-evaluation: the learner scores its own predictions once their outcome is known.

`Scorer.watch` predicts the next camera for a sample of the exits as they are learned. Once the
longest lag after an exit has passed, the fit of a later version gives the probability r of each
next camera, or of none (`outcomes`), and `Scorer.mark` gives the prediction its expected score: the
log loss is ``-sum r log p``. The *baseline* is the Markov chain over cameras (thesis 4.6).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence, Set
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from camtopod.event_time import MICROSECONDS
from camtopod.learn.outcomes import Happened, ScoredPrediction
from camtopod.learn.prediction_model import SHARE_MIN
from camtopod.markov_chain import estimate_markov_chain
from camtopod.predict import Predictor, PredictorState
from camtopod.records import Event, SelfScore, Topology
from camtopod.topology import weak_links
from camtopod.words import sum_by_camera

EXITS_PER_VERSION = 100
"""Approximate number of exits that are predicted between two versions, evenly spread."""
SCORED_MAX = 2000
"""Number of the newest scored predictions over which the score is the mean, and largest number of
predictions that wait for their outcome: beyond, the oldest is dropped.
"""


class Scores(NamedTuple):
    """Scores of one prediction."""

    version: int
    """Version with which the prediction was made."""
    return_probability: float
    """Probability, by the later fit, that the object appeared again."""
    top1: float
    """Probability, by the later fit, that it appeared at the likeliest predicted camera."""
    top3: float
    """Probability, by the later fit, that it appeared at one of the three likeliest ones."""
    loss: float
    """Expected log loss, nats."""
    baseline_top1: float
    """``top1`` of the baseline."""
    baseline_loss: float
    """``loss`` of the baseline, nats."""


class ScorerState(Struct):
    """The state of a `Scorer`, apart from the topology that it predicts with."""

    predictor: PredictorState | None = None
    """State of the predictor; it is set when the state is saved."""
    baseline: dict[str, dict[str, float]] = {}
    """Probabilities of the Markov chain: camera of the exit -> next camera, "" for none."""
    stride: int = 1
    """Every how many exits one is predicted."""
    exits: int = 0
    """Number of exits so far."""
    waiting: list[ScoredPrediction] = []
    """Predictions that wait for their outcome, at most `SCORED_MAX`, oldest first."""
    marks: list[Scores] = []
    """Scores of the newest scored predictions, at most `SCORED_MAX`, oldest first."""


class Scorer:
    """Predicts a sample of the exits as events are learned, and scores the predictions later.

    topology: the version that predictions are made with; None if there is none yet.
    """

    def __init__(self, state: ScorerState, topology: Topology | None) -> None:
        self.state = state
        self._predictor: Predictor | None = None
        if state.predictor is not None and topology is not None:
            self._predictor = Predictor(topology)
            self._predictor.load(state.predictor)
        state.predictor = None

    def predictor_state(self) -> PredictorState | None:
        """Return the state of the predictor; None if there is none yet."""
        return None if self._predictor is None else self._predictor.save()

    def forget(self, names: Set[str]) -> None:
        """Drop the predictions of these cameras that wait for their outcome."""
        self.state.waiting = [
            prediction for prediction in self.state.waiting if prediction.camera not in names
        ]

    def watch(self, batch: Iterable[tuple[int, Event]]) -> None:
        """Predict the next camera of some of the exits among new events.

        batch (microseconds, event): the new events in order of time.
        """
        predictor = self._predictor
        if predictor is None:
            return
        state = self.state
        for t_us, event in batch:
            if event.kind == "exit":
                state.exits += 1
                if state.exits % state.stride == 0 and predictor.zone_of(event) is not None:
                    prediction = predictor.predict(event)
                    shares = {"": prediction.leave, **sum_by_camera(prediction.next)}
                    baseline = state.baseline.get(event.camera, {"": 1.0})
                    version = predictor.version
                    state.waiting.append(
                        ScoredPrediction(
                            t_us / MICROSECONDS,
                            event.camera,
                            version,
                            shares,
                            baseline,
                            predictor.prepared.longest_lag,
                        )
                    )
                    del state.waiting[:-SCORED_MAX]
            predictor.observe(event)

    def use(self, topology: Topology, events_due: float) -> None:
        """Predict with the version ``topology`` from here on.

        events_due: number of events expected until the next version.
        """
        newer = Predictor(topology)
        if self._predictor is not None:
            newer.take_over(self._predictor)
        self._predictor = newer
        self.state.stride = max(1, math.ceil(events_due / 2 / EXITS_PER_VERSION))
        links = [*topology.links, *weak_links(topology)]
        baseline = estimate_markov_chain(topology.zones, links)
        for shares in baseline.values():
            shares[""] = max(1.0 - sum(shares.values()), 0.0)
        self.state.baseline = baseline

    def mark(self, outcomes: Sequence[Happened | None]) -> None:
        """Score the oldest waiting predictions, and remove them from those that wait.

        outcomes: outcomes of the oldest predictions, in order; None for a prediction that is
            dropped without a score.
        """
        for outcome in outcomes:
            prediction = self.state.waiting.pop(0)
            if outcome is not None:
                self.note(prediction, outcome)

    def note(self, guess: ScoredPrediction, outcome: dict[str, float]) -> None:
        """Score one prediction, and add its scores to the mean.

        outcome: probability, by camera, that the object appeared there next.
        """
        self.state.marks.append(marks(guess, outcome))
        del self.state.marks[:-SCORED_MAX]

    def score(self) -> SelfScore | None:
        """Return the mean of the newest scores; None before any prediction has been scored."""
        if not self.state.marks:
            return None
        m = Scores(*(np.array(column) for column in zip(*self.state.marks, strict=True)))  # type: ignore[arg-type]
        return_sum = max(float(np.sum(m.return_probability)), 1e-9)
        return SelfScore(
            exits=len(self.state.marks),
            since_version=self.state.marks[0].version,
            log_loss=_short(np.mean(m.loss)),
            top1=_short(np.sum(m.top1) / return_sum),
            top3=_short(np.sum(m.top3) / return_sum),
            baseline_log_loss=_short(np.mean(m.baseline_loss)),
            baseline_top1=_short(np.sum(m.baseline_top1) / return_sum),
        )


def marks(guess: ScoredPrediction, outcome: dict[str, float]) -> Scores:
    """Return the scores of a prediction.

    outcome: probability, by camera, that the object appeared there next.
    """
    return_probability = sum(outcome.values())
    outcomes = {**outcome, "": max(1.0 - return_probability, 0.0)}
    ranking, usual = (_ranked(shares) for shares in (guess.shares, guess.baseline))
    return Scores(
        guess.version,
        return_probability,
        sum(outcome.get(camera, 0.0) for camera in ranking[:1]),
        sum(outcome.get(camera, 0.0) for camera in ranking[:3]),
        _loss(guess.shares, outcomes),
        sum(outcome.get(camera, 0.0) for camera in usual[:1]),
        _loss(guess.baseline, outcomes),
    )


def _ranked(shares: dict[str, float]) -> list[str]:
    """Return the cameras, likeliest first."""
    return sorted(
        (camera for camera in shares if camera), key=lambda camera: (-shares[camera], camera)
    )


def _loss(shares: dict[str, float], outcomes: dict[str, float]) -> float:
    """Return the expected log loss, -ln(predicted probability of the outcome), in nats.

    shares: predicted probability of each outcome.
    outcomes: probability that each outcome has happened.

    A camera that is not predicted counts with the least share that a model lists.
    """
    return -sum(
        r * math.log(max(shares.get(camera, 0.0), SHARE_MIN))
        for camera, r in outcomes.items()
        if r > 0
    )


def _short(value: float | np.floating) -> float:
    """Round to four decimals."""
    return round(float(value), 4)
