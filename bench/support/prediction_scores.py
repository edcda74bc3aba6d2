"""Score of predictions of the next camera, and of learned clocks, against the ground truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from camtopod.records import Event, Prediction, Topology
from camtopod.sim.truth import CLUTTER, Truth

PROBABILITY_FLOOR = 1e-6
"""Least probability in the log loss: an outcome stated as impossible costs 13.8 nats."""
CALIBRATION_BINS = 10
"""Number of equal bins of probability."""


class PredictionScore(Struct, frozen=True):
    """Score of predictions of the next camera, over exits that belong to an object."""

    exits: int
    """Number of exits scored."""
    followed: int
    """Number of them whose object was recorded again."""
    top1: float
    """Share of the followed exits whose next camera had the highest probability; nan if none."""
    top3: float
    """Share of the followed exits whose next camera was among the three likeliest."""
    log_loss: float
    """Mean of -ln(probability of the outcome: that camera, or not seen again) over all exits,
    nats.
    """
    calibration_error: float = math.nan
    """Expected calibration error of all stated probabilities, that of leaving the site included.

    Most of them are close to 0, where no method is far off.
    """
    first_calibration_error: float = math.nan
    """Expected calibration error of the likeliest outcome alone, which may be leaving the site."""
    first_calibration_floor: float = math.nan
    """Value of `first_calibration_error` that chance would give if every probability were right."""
    first_calibration_error_all: float = math.nan
    """As `first_calibration_error`, over all exits, those of clutter included.

    A prediction cannot know which exits are clutter (no object arrives after them). Right
    probabilities over all exits therefore look too cautious over the exits of objects alone.
    """
    window_coverage: float = math.nan
    """Share of followed exits with the next camera stated whose arrival is between q10 and q90."""


def next_entries(events: Sequence[Event], truth: Truth) -> list[int]:
    """Return for each exit of an object the index of the entry where it appears next; otherwise
    -1.
    """

    # Entries of each walker, by number of the passage.
    entries: dict[int, list[tuple[int, int]]] = {}
    for index, (event, identity, number) in enumerate(
        zip(events, truth.identity, truth.passage, strict=True)
    ):
        if identity != CLUTTER and event.kind == "entry":
            entries.setdefault(identity, []).append((number, index))
    for passages in entries.values():
        passages.sort()

    # The first entry after each exit.
    result = []
    for event, identity, number in zip(events, truth.identity, truth.passage, strict=True):
        later = []
        if event.kind == "exit":
            later = [index for n, index in entries.get(identity, []) if n > number]
        result.append(later[0] if later else -1)
    return result


def score_predictions(
    predictions: Iterable[Prediction],
    events: Sequence[Event],
    truth: Truth,
    since: float = -math.inf,
    zone_of: Callable[[Event], str | None] | None = None,
) -> PredictionScore:
    """Score one prediction for each exit of ``events``, in order; exits before ``since`` do not
    count.

    zone_of: returns the zone of an entry, whose time window is then checked; without it, the window
    of the camera's likeliest zone is. Raises ValueError if the predictions are not for these
    events.
    """

    # What happened after each exit.
    next_entry = next_entries(events, truth)
    exits = [index for index, event in enumerate(events) if event.kind == "exit"]

    # Compare each prediction with it.
    top1 = top3 = followed = scored = 0
    loss = 0.0
    probabilities: list[float] = []
    hits: list[bool] = []
    firsts: list[_Guess] = []
    within: list[bool] = []
    for index, prediction in zip(exits, predictions, strict=True):
        event = events[index]
        if prediction.camera != event.camera or abs(prediction.t - event.t) > 1e-5:
            raise ValueError(
                f"the prediction for {prediction.camera} at {prediction.t} is not for exit line "
                f"{index + 1}"
            )
        if event.t < since:
            continue
        entry = events[next_entry[index]] if next_entry[index] >= 0 else None
        by_camera = _by_camera(prediction)
        firsts.append(_first(prediction.leave, by_camera, entry, truth.identity[index] == CLUTTER))
        if firsts[-1].clutter:
            continue
        scored += 1
        if entry is not None:
            ranking = sorted(by_camera, key=lambda name: -by_camera[name])
            followed += 1
            top1 += ranking[:1] == [entry.camera]
            top3 += entry.camera in ranking[:3]
            within += _within(prediction, entry, zone_of(entry) if zone_of else None)
        outcome = prediction.leave if entry is None else by_camera.get(entry.camera, 0.0)
        loss -= math.log(max(outcome, PROBABILITY_FLOOR))
        probabilities += [*by_camera.values(), prediction.leave]
        hits += [
            *(entry is not None and camera == entry.camera for camera in by_camera),
            entry is None,
        ]

    # Average over the exits.
    object_guesses = [guess for guess in firsts if not guess.clutter]
    return PredictionScore(
        exits=scored,
        followed=followed,
        top1=top1 / followed if followed else math.nan,
        top3=top3 / followed if followed else math.nan,
        log_loss=loss / scored if scored else math.nan,
        calibration_error=calibration_error(probabilities, hits),
        first_calibration_error=_calibration_error(object_guesses),
        first_calibration_floor=calibration_floor([guess.probability for guess in object_guesses]),
        first_calibration_error_all=_calibration_error(firsts),
        window_coverage=float(np.mean(within)) if within else math.nan,
    )


class _Guess(NamedTuple):
    """Likeliest outcome of an exit: its probability, whether it happened, whether the exit was
    clutter.
    """

    probability: float
    hit: bool
    clutter: bool


def _first(leave: float, by_camera: dict[str, float], entry: Event | None, clutter: bool) -> _Guess:
    """Return the likeliest outcome of a prediction."""
    camera = max(by_camera, key=lambda name: by_camera[name], default=None)
    if camera is None or leave > by_camera[camera]:
        return _Guess(leave, entry is None, clutter)
    return _Guess(by_camera[camera], entry is not None and entry.camera == camera, clutter)


def _calibration_error(guesses: Sequence[_Guess]) -> float:
    """Return the expected calibration error of the likeliest outcomes."""
    return calibration_error(
        [guess.probability for guess in guesses], [guess.hit for guess in guesses]
    )


def _by_camera(prediction: Prediction) -> dict[str, float]:
    """Return camera -> probability of being next."""
    result: dict[str, float] = {}
    for choice in prediction.next:
        result[choice.camera] = result.get(choice.camera, 0.0) + choice.probability
    return result


def _within(prediction: Prediction, entry: Event, zone: str | None) -> list[bool]:
    """Return [whether the entry is in the stated window of its zone]; [] if its camera is not
    stated.

    Without a zone it is the window of the camera's likeliest zone.
    """
    choices = [choice for choice in prediction.next if choice.camera == entry.camera]
    for choice in [choice for choice in choices if choice.zone == zone] or choices:
        return [choice.q10 <= entry.t - prediction.t <= choice.q90]
    return []


def clock_errors(topology: Topology, truth: Truth) -> dict[str, float]:
    """Return learned minus true clock offset of each learned camera, seconds.

    Only differences between clocks can be learned, so the median error is subtracted from all.
    """
    error = {c.id: c.clock_offset - truth.clock_offsets.get(c.id, 0.0) for c in topology.cameras}
    gauge = float(np.median(list(error.values()))) if error else 0.0
    return {camera: value - gauge for camera, value in error.items()}


def calibration_error(probability: Sequence[float], hits: Sequence[bool]) -> float:
    """Return the expected calibration error; nan without any probability.

    It is |mean stated probability - observed frequency| of equal bins of probability, averaged with
    the number of outcomes in each bin as weight.
    """
    if not probability:
        return math.nan
    probabilities = np.array(probability)
    outcomes = np.array(hits, dtype=float)
    gap = np.bincount(_bin(probabilities), probabilities - outcomes, CALIBRATION_BINS)
    return float(np.abs(gap).sum() / len(probabilities))


def calibration_floor(probability: Sequence[float]) -> float:
    """Return the expected calibration error of as many perfectly calibrated probabilities; nan
    without any.

    An error of this size is explained by chance alone.
    """
    if not probability:
        return math.nan
    probabilities = np.array(probability)
    variance = np.bincount(
        _bin(probabilities), probabilities * (1.0 - probabilities), CALIBRATION_BINS
    )
    return float(math.sqrt(2.0 / math.pi) * np.sqrt(variance).sum() / len(probabilities))


def _bin(probabilities: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.minimum((probabilities * CALIBRATION_BINS).astype(np.int64), CALIBRATION_BINS - 1)
