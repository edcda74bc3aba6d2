"""Self-evaluation: the learner scores its own predictions once their outcome is known.

`Scorer.watch` predicts the next camera for a sample of the exits as they are learned, with the
version of that time. Objects are anonymous, so the true outcome is never known for certain. But
once the longest lag after an exit has passed, the fit of a later version gives the probability r of
each next camera, or of none (`outcomes`). `Scorer.mark` then gives the prediction its expected
score under that fit: the log loss is ``-sum r log p`` in place of ``-log p``. An exit event that is
of no object counts as an object that leaves the site. The *baseline* for comparison is the Markov
chain over cameras (thesis 4.6).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence, Set
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from camtopod.event_time import MICROSECONDS
from camtopod.learn.outcomes import Happened
from camtopod.predict import Predictor, PredictorState
from camtopod.records import Event, Prediction, SelfScore, Topology

EXITS_PER_VERSION = 100
"""Approximate number of exits that are predicted between two versions, evenly spread."""
SCORED_MAX = 2000
"""Number of the newest scored predictions over which the score is the mean."""
PENDING_MAX = 2000
"""Largest number of predictions that wait for their outcome; beyond, the oldest is dropped."""
PROBABILITY_FLOOR = 1e-4
"""Lower bound on a predicted probability in the log loss."""


class ScoredPrediction(NamedTuple):
    """A prediction that is to be scored.

    Probabilities are by name of the next camera, with "" for leaving the site.
    """

    t: float
    """Time of the exit, seconds."""
    camera: str
    """Camera of the exit."""
    version: int
    """Version with which the prediction was made."""
    said: dict[str, float]
    """Predicted probabilities."""
    baseline: dict[str, float]
    """Probabilities of the baseline, the Markov chain over cameras."""


class Scores(NamedTuple):
    """Scores of one prediction."""

    version: int
    """Version with which the prediction was made."""
    followed: float
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
    """The saved state of a `Scorer`, apart from the topology that it predicts with."""

    predictor: PredictorState | None
    baseline: dict[str, dict[str, float]]
    """Probabilities of the Markov chain: camera of the exit -> next camera, "" for none."""
    stride: int
    """Every how many exits one is predicted."""
    exits: int
    """Number of exits so far."""
    guesses: list[ScoredPrediction]
    """Predictions that wait for their outcome, oldest first."""
    marks: list[Scores]
    """Scores of the newest scored predictions, oldest first."""


class Scorer:
    """Predicts a sample of the exits as events are learned, and scores the predictions later.

    The private attributes are described at `ScorerState`.
    """

    def __init__(self) -> None:
        self._predictor: Predictor | None = None
        self._baseline: dict[str, dict[str, float]] = {}
        self._stride = 1
        self._exits = 0
        self._guesses: deque[ScoredPrediction] = deque(maxlen=PENDING_MAX)
        self._marks: deque[Scores] = deque(maxlen=SCORED_MAX)

    def save(self) -> ScorerState:
        """Return the state from which `load` continues, apart from the topology."""
        predictor = None if self._predictor is None else self._predictor.save()
        return ScorerState(
            predictor,
            self._baseline,
            self._stride,
            self._exits,
            list(self._guesses),
            list(self._marks),
        )

    def load(self, state: ScorerState, topology: Topology | None) -> None:
        """Continue from a saved state.

        topology: the version that predictions are made with.
        """
        if state.predictor is not None and topology is not None:
            self._predictor = Predictor(topology)
            self._predictor.load(state.predictor)
        self._baseline, self._stride, self._exits = state.baseline, state.stride, state.exits
        self._guesses.extend(state.guesses)
        self._marks.extend(state.marks)

    def forget(self, names: Set[str]) -> None:
        """Drop the predictions of these cameras that wait for their outcome."""
        self._guesses = deque(
            (guess for guess in self._guesses if guess.camera not in names), PENDING_MAX
        )

    def watch(self, batch: Iterable[tuple[int, Event]]) -> None:
        """Predict the next camera of some of the exits among new events.

        batch (microseconds, event): the new events in order of time.
        """
        predictor = self._predictor
        if predictor is None:
            return
        for t_us, event in batch:
            if event.kind == "exit":
                self._exits += 1
                if self._exits % self._stride == 0 and predictor.zone_of(event) is not None:
                    said = _by_camera(predictor.predict(event))
                    baseline = self._baseline.get(event.camera, {"": 1.0})
                    version = predictor.version
                    self._guesses.append(
                        ScoredPrediction(t_us / MICROSECONDS, event.camera, version, said, baseline)
                    )
            predictor.observe(event)

    def use(self, topology: Topology, events_due: float) -> None:
        """Predict with the version ``topology`` from here on.

        events_due: number of events expected until the next version.
        """
        self._predictor = (
            Predictor(topology) if self._predictor is None else self._predictor.follow(topology)
        )
        self._stride = max(1, math.ceil(events_due / 2 / EXITS_PER_VERSION))
        self._baseline = {}
        for edge in topology.chain or []:
            self._baseline.setdefault(edge.from_, {})[edge.to] = edge.probability
        for shares in self._baseline.values():
            shares[""] = max(1.0 - sum(shares.values()), 0.0)

    @property
    def waiting(self) -> list[ScoredPrediction]:
        """Predictions whose outcome is not known yet, oldest first."""
        return list(self._guesses)

    def mark(self, happened: Sequence[Happened | None]) -> None:
        """Score the oldest waiting predictions, and remove them from those that wait.

        happened: outcomes of the oldest predictions, in order; None for a prediction that is
            dropped without a score.
        """
        for outcome in happened:
            guess = self._guesses.popleft()
            if outcome is not None:
                self.note(guess, outcome)

    def note(self, guess: ScoredPrediction, happened: dict[str, float]) -> None:
        """Score one prediction, and add its scores to the mean.

        happened: probability, by camera, that the object appeared there next.
        """
        self._marks.append(marks(guess, happened))

    def score(self) -> SelfScore | None:
        """Return the mean of the newest scores; None before any prediction has been scored."""
        if not self._marks:
            return None
        m = Scores(*(np.array(column) for column in zip(*self._marks, strict=True)))  # type: ignore[arg-type]
        followed = max(float(np.sum(m.followed)), 1e-9)
        return SelfScore(
            exits=len(self._marks),
            since_version=self._marks[0].version,
            log_loss=_short(np.mean(m.loss)),
            top1=_short(np.sum(m.top1) / followed),
            top3=_short(np.sum(m.top3) / followed),
            baseline_log_loss=_short(np.mean(m.baseline_loss)),
            baseline_top1=_short(np.sum(m.baseline_top1) / followed),
        )


def _by_camera(prediction: Prediction) -> dict[str, float]:
    """Return the probability of each next camera, by name, with "" for leaving the site."""
    said = {"": prediction.leave}
    for choice in prediction.next_:
        said[choice.camera] = said.get(choice.camera, 0.0) + choice.probability
    return said


def marks(guess: ScoredPrediction, happened: dict[str, float]) -> Scores:
    """Return the scores of a prediction.

    happened: probability, by camera, that the object appeared there next.
    """
    followed = sum(happened.values())
    outcomes = {**happened, "": max(1.0 - followed, 0.0)}
    ranked, usual = (_ranked(shares) for shares in (guess.said, guess.baseline))
    return Scores(
        guess.version,
        followed,
        sum(happened.get(camera, 0.0) for camera in ranked[:1]),
        sum(happened.get(camera, 0.0) for camera in ranked[:3]),
        _loss(guess.said, outcomes),
        sum(happened.get(camera, 0.0) for camera in usual[:1]),
        _loss(guess.baseline, outcomes),
    )


def _ranked(shares: dict[str, float]) -> list[str]:
    """Return the cameras, likeliest first."""
    return sorted(
        (camera for camera in shares if camera), key=lambda camera: (-shares[camera], camera)
    )


def _loss(said: dict[str, float], outcomes: dict[str, float]) -> float:
    """Return the expected log loss, -ln(predicted probability of the outcome), in nats.

    said: predicted probability of each outcome.
    outcomes: probability that each outcome has happened.
    """
    return -sum(
        r * math.log(max(said.get(camera, 0.0), PROBABILITY_FLOOR))
        for camera, r in outcomes.items()
        if r > 0
    )


def _short(value: float | np.floating) -> float:
    """Round to four decimals."""
    return round(float(value), 4)
