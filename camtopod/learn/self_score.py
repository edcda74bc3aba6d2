"""The learner marks its own predictions: each made with the version of its time, before the
outcome.

Nobody says who went where. But a departure's outcome is far plainer afterwards than before: once
its whole lag window has been seen, the joint fit of a later version knows with what probability it
was each of the arrivals that came, or none. The prediction is scored by what that fit expects it to
earn: ``-sum r log p`` in place of ``-log p``. Events that belong to nobody count as objects that
leave.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Set
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from camtopod.arrays import Floats
from camtopod.event_time import MICROSECONDS
from camtopod.learn.next_camera import Posterior
from camtopod.learn.traffic import Arrivals, Departures
from camtopod.predict import Predictor, PredictorState
from camtopod.records import Event, Prediction, SelfScore, Topology

EXITS_PER_VERSION = 100
"""Exits scored of those between two versions, or a few more, evenly spread."""
SCORED_MAX = 2000
"""The score is over this many exits, the newest."""
PENDING_MAX = 2000
"""Predictions that wait for their outcome; beyond, the oldest is forgotten."""
PROBABILITY_FLOOR = 1e-4


class Guess(NamedTuple):
    """Where an exit at ``t`` (seconds) from ``camera`` was said to lead: probability by camera, ""
    for leaving.
    """

    t: float
    camera: str
    version: int
    said: dict[str, float]
    baseline: dict[str, float]


class Marks(NamedTuple):
    """What one prediction earned."""

    version: int
    followed: float
    """Probability that the object was seen again."""
    top1: float
    top3: float
    loss: float
    baseline_top1: float
    baseline_loss: float


class ScorerState(Struct):
    """What a `Scorer` knows beside the topology."""

    predictor: PredictorState | None
    baseline: dict[str, dict[str, float]]
    stride: int
    exits: int
    guesses: list[Guess]
    marks: list[Marks]


class Scorer:
    """Predicts a sample of the exits as the events come and marks them when a later fit knows
    better.
    """

    def __init__(self) -> None:
        self._predictor: Predictor | None = None
        self._baseline: dict[str, dict[str, float]] = {}
        self._stride = 1
        self._exits = 0
        self._guesses: deque[Guess] = deque(maxlen=PENDING_MAX)
        self._marks: deque[Marks] = deque(maxlen=SCORED_MAX)

    def save(self) -> ScorerState:
        """Everything `load` needs, beside the topology, to go on from here."""
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
        """Go on from there; ``topology`` is the version it predicts with."""
        if state.predictor is not None and topology is not None:
            self._predictor = Predictor(topology)
            self._predictor.load(state.predictor)
        self._baseline, self._stride, self._exits = state.baseline, state.stride, state.exits
        self._guesses.extend(state.guesses)
        self._marks.extend(state.marks)

    def forget(self, names: Set[str]) -> None:
        """Forget what waits for its outcome at these cameras."""
        self._guesses = deque(
            (guess for guess in self._guesses if guess.camera not in names), PENDING_MAX
        )

    def watch(self, batch: Iterable[tuple[int, Event]]) -> None:
        """Events by time, each with its time in microseconds: predict some of the exits."""
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
                        Guess(t_us / MICROSECONDS, event.camera, version, said, baseline)
                    )
            predictor.observe(event)

    def use(self, topology: Topology, events_due: float) -> None:
        """Predict with this version from here on; about ``events_due`` events will come before the
        next.
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

    def mark(
        self,
        posterior: Posterior,
        departures: Departures,
        arrivals: Arrivals,
        cameras: list[str],
        over: float,
        ahead: Floats,
    ) -> None:
        """Mark what left until ``over`` (seconds), from when on a lag window may still be open.

        ``ahead`` (cameras,): by how many seconds each camera's clock is; departures and arrivals
        are in right time.
        """
        due = []
        while self._guesses and self._guesses[0].t <= over:
            due.append(self._guesses.popleft())
        rows = [_row_of(guess, departures, cameras, ahead) for guess in due]
        known = [(guess, row) for guess, row in zip(due, rows, strict=True) if row is not None]
        outcomes = _outcomes(posterior, arrivals, [row for _, row in known], len(cameras))
        for (guess, _), outcome in zip(known, outcomes, strict=True):
            happened = {cameras[k]: float(outcome[k]) for k in np.flatnonzero(outcome)}
            self.note(guess, happened)

    def note(self, guess: Guess, happened: dict[str, float]) -> None:
        """Mark one guess; ``happened``: with what probability the object appeared at which
        camera.
        """
        self._marks.append(marks(guess, happened))

    def score(self) -> SelfScore | None:
        """The score as of now; None before any exit has been scored."""
        if not self._marks:
            return None
        m = Marks(*(np.array(column) for column in zip(*self._marks, strict=True)))  # type: ignore[arg-type]
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
    """Probability of each next camera, and of leaving under ""."""
    said = {"": prediction.leave}
    for choice in prediction.next_:
        said[choice.camera] = said.get(choice.camera, 0.0) + choice.probability
    return said


def _row_of(guess: Guess, departures: Departures, cameras: list[str], ahead: Floats) -> int | None:
    """The departure that the guess was about; None when it is not in the fit."""
    camera = cameras.index(guess.camera)
    t = guess.t - ahead[camera]
    low, high = np.searchsorted(departures.t, (t, np.nextafter(t, np.inf)))
    rows = low + np.flatnonzero(departures.camera[low:high] == camera)
    return int(rows[0]) if len(rows) else None


def _outcomes(posterior: Posterior, arrivals: Arrivals, rows: list[int], cameras: int) -> Floats:
    """Probability (rows, cameras) that each of the departures ``rows`` appears next at each camera.

    Of each candidate what may as well be chance is left out (`doubt`).
    """
    result = np.zeros((len(rows), cameras))
    c = posterior.fit.candidates
    of = np.full(int(c.departure.max(initial=-1)) + 1, -1)
    for number, row in enumerate(rows):
        if row < len(of):
            of[row] = number
    asked = np.flatnonzero(of[c.departure] >= 0)
    sure = posterior.fit.responsibility[asked] * (1.0 - posterior.doubt[c.pair[asked]])
    np.add.at(result, (of[c.departure[asked]], arrivals.camera[c.arrival[asked]]), sure)
    total = result.sum(axis=1, keepdims=True)
    shares: Floats = result / np.maximum(total, 1.0)
    return shares


def marks(guess: Guess, happened: dict[str, float]) -> Marks:
    """What the guess earned when the object appeared at each camera with the probabilities
    ``happened``.
    """
    followed = sum(happened.values())
    outcomes = {**happened, "": max(1.0 - followed, 0.0)}
    ranked, usual = (_ranked(shares) for shares in (guess.said, guess.baseline))
    return Marks(
        guess.version,
        followed,
        sum(happened.get(camera, 0.0) for camera in ranked[:1]),
        sum(happened.get(camera, 0.0) for camera in ranked[:3]),
        _loss(guess.said, outcomes),
        sum(happened.get(camera, 0.0) for camera in usual[:1]),
        _loss(guess.baseline, outcomes),
    )


def _ranked(shares: dict[str, float]) -> list[str]:
    """Cameras, the likeliest first."""
    return sorted(
        (camera for camera in shares if camera), key=lambda camera: (-shares[camera], camera)
    )


def _loss(said: dict[str, float], outcomes: dict[str, float]) -> float:
    """Expected -ln(probability of what happened), nats."""
    return -sum(
        r * math.log(max(said.get(camera, 0.0), PROBABILITY_FLOOR))
        for camera, r in outcomes.items()
        if r > 0
    )


def _short(value: float | np.floating) -> float:
    """Four decimals."""
    return round(float(value), 4)
