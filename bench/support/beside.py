"""Figures of other methods on a real recording: process mining, and a rule of home automation.

The rule (`baselines.area_occupancy`) predicts only which camera is next. It and camtopod are
therefore scored on the exits after the cut whose object appears at another camera at any time
later.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct

from bench.baselines.area_occupancy import AreaOccupancy
from bench.baselines.process_mining import mined_links
from bench.support.recordings import SPURIOUS_TRANSITIONS_MAX, Recording
from camtopod.records import Prediction

OURS_LEAST = 1e-3
"""Added to our probability of every camera."""
WHO = ("ours", "rule", "rule, told")
"""Whose figures of the next camera there are: ours, the rule with every pair of cameras, the rule
told the true neighbours.
"""


class MinedFigures(Struct):
    """Figures of links between cameras that were mined."""

    true: int
    right: int
    false: int
    transit_error: float
    """Median over the right links of the error of their mean, seconds; nan without any."""


class FollowingFigures(Struct):
    """Figures of the next camera, given that there is one."""

    exits: int
    log_loss: float
    top1: float


def mined_figures(recording: Recording) -> MinedFigures | None:
    """Mine the passages before the cut and score the links; None if the miner is not installed."""
    passages = [passage for passage in recording.passages.values() if passage.begin < recording.cut]
    try:
        mined = mined_links(sorted(passages, key=lambda passage: passage.begin))
    except ModuleNotFoundError:
        return None
    true, transitions = recording.links(), recording.transitions()
    right = mined.keys() & true.keys()
    false = [p for p in mined if len(transitions.get(p, ())) <= SPURIOUS_TRANSITIONS_MAX]
    errors = [abs(mined[pair] - np.mean(true[pair])) for pair in right]
    error = float(np.median(errors)) if errors else float("nan")
    return MinedFigures(len(true), len(right), len(false), error)


def following_figures(
    predictions: Sequence[Prediction], recording: Recording
) -> list[FollowingFigures]:
    """Score the next camera by each of `WHO`; the list is empty if there is no exit to score.

    predictions: those of every exit, in order.
    """
    cameras = recording.cameras
    cases = []
    for prediction in predictions:
        next_passage = recording.passages[str(prediction.track)].next_
        elsewhere = next_passage is not None and next_passage.camera != prediction.camera
        if next_passage is not None and elsewhere and prediction.t >= recording.cut:
            cases.append((prediction, next_passage.camera))
    if not cases:
        return []
    next_cameras = [camera for _, camera in cases]
    figures = [_judged([_ours(prediction, cameras) for prediction, _ in cases], next_cameras)]

    # The rule, with every pair and told the true neighbours.
    all_pairs = {(a, b) for a in cameras for b in cameras if a != b}
    for neighbours in (all_pairs, recording.links().keys()):
        rule = AreaOccupancy(set(neighbours))
        rule.learn(recording.events, recording.cut)
        guesses = [rule.guess(prediction.camera, prediction.t, cameras) for prediction, _ in cases]
        figures.append(_judged(guesses, next_cameras))
    return figures


def _ours(prediction: Prediction, cameras: Sequence[str]) -> dict[str, float]:
    """Return our probability of each other camera, given that the object appears at one."""
    weight = {name: OURS_LEAST for name in cameras if name != prediction.camera}
    for way in prediction.next:
        if way.camera in weight:
            weight[way.camera] += way.probability
    total = sum(weight.values())
    return {name: value / total for name, value in weight.items()}


def _judged(
    guesses: Sequence[Mapping[str, float]], next_cameras: Sequence[str]
) -> FollowingFigures:
    """Score guesses by the cameras that were next."""
    losses = [-np.log(guess[camera]) for guess, camera in zip(guesses, next_cameras, strict=True)]
    first = [max(guess, key=lambda name: guess[name]) for guess in guesses]
    right = [name == camera for name, camera in zip(first, next_cameras, strict=True)]
    return FollowingFigures(len(next_cameras), float(np.mean(losses)), float(np.mean(right)))
