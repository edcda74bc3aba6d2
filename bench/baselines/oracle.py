"""An oracle that is given all identities: its predictions of the next camera, its transit times.

The predictors count, before the cut, which camera followed an exit in each state (a zone, or a
camera), or that none did. Every camera that ever followed anywhere, and leaving the site, get a
pseudo-count, so that nothing has probability zero; its size is chosen on the ground truth. With
states that are cameras this is the most frequent next camera; with zones, a Markov chain.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Sequence

import numpy as np
from msgspec.structs import replace

from bench.support.prediction_scores import PredictionScore, next_entries, score_predictions
from camtopod.records import Event, NextCamera, Prediction
from camtopod.sim.scoring import TRANSIT_FLOOR_SECONDS
from camtopod.sim.truth import CLUTTER, Truth

PSEUDO_COUNTS = (0.5, 0.2, 0.1, 0.05, 0.02)
"""Candidate pseudo-counts.

Half a count for each of a dozen cameras is much beside the few exits of a state; too small a count
makes the predictions overconfident.
"""
LEAVES = ""
"""Outcome of an exit that nothing follows: the object left the site."""


def oracle_score(
    events: Sequence[Event], truth: Truth, cut: int, states: Sequence[Hashable]
) -> PredictionScore:
    """Return the score of `oracle_predictions` on the events from ``cut`` on, with the best of
    `PSEUDO_COUNTS`.
    """
    tail = replace(
        truth, identity=truth.identity[cut:], passage=truth.passage[cut:], zone=truth.zone[cut:]
    )
    scores = [
        score_predictions(oracle_predictions(events, truth, cut, states, a), events[cut:], tail)
        for a in PSEUDO_COUNTS
    ]
    return min(scores, key=lambda result: result.log_loss)


def oracle_predictions(
    events: Sequence[Event], truth: Truth, cut: int, states: Sequence[Hashable], pseudo_count: float
) -> list[Prediction]:
    """Return a prediction for each exit from event ``cut`` on, by earlier exits in its state.

    ``states[i]`` is the state of event ``i``. In an unknown state all exits together are used.
    """
    # Count what followed each state.
    successors: dict[Hashable, Counter[str]] = {}
    overall: Counter[str] = Counter()
    for index, entry in enumerate(next_entries(events, truth)[:cut]):
        if entry < cut and events[index].kind == "exit" and truth.identity[index] != CLUTTER:
            outcome = events[entry].camera if entry >= 0 else LEAVES
            successors.setdefault(states[index], Counter())[outcome] += 1
            overall[outcome] += 1

    # Predict.
    outcomes = sorted(overall.keys() | {LEAVES})
    predictions = []
    for index in range(cut, len(events)):
        event = events[index]
        if event.kind == "exit":
            counts = successors.get(states[index], overall)
            total = counts.total() + pseudo_count * len(outcomes)
            share = {outcome: (counts[outcome] + pseudo_count) / total for outcome in outcomes}
            leave = share.pop(LEAVES)
            ranking = sorted(share.items(), key=lambda item: -item[1])
            choices = [NextCamera(camera, "", p, 0.0, 0.0, 0.0) for camera, p in ranking]
            predictions.append(Prediction(event.camera, None, event.t, None, 0, leave, choices))
    return predictions


def recorded_medians(events: Sequence[Event], truth: Truth) -> Truth:
    """Return the truth with the recorded median transit time of each link, by camera clocks."""
    # Ends of each passage: (identity, passage) -> kind -> (seconds, zone).
    ends: dict[tuple[int, int], dict[str, tuple[float, int]]] = {}
    for event, identity, number, zone in zip(
        events, truth.identity, truth.passage, truth.zone, strict=True
    ):
        if identity != CLUTTER and zone >= 0:
            ends.setdefault((identity, number), {})[event.kind] = event.t, zone

    # Transit times of each link, from one passage to the object's next.
    seconds: dict[tuple[str, str], list[float]] = {}
    for (identity, number), end in ends.items():
        onward = ends.get((identity, number + 1), {})
        if "exit" in end and "entry" in onward:
            (exit_time, u), (entry_time, v) = end["exit"], onward["entry"]
            seconds.setdefault((truth.zones[u].id, truth.zones[v].id), []).append(
                entry_time - exit_time
            )

    # Replace the medians.
    links = []
    for link in truth.links:
        times = seconds.get((link.from_, link.to))
        if link.relation != "visible" and times:
            link = replace(link, transit=replace(link.transit, q50=float(np.median(times))))
        links.append(link)
    return replace(truth, links=links)


def transit_error(events: Sequence[Event], truth: Truth) -> float:
    """Return the median over the walked links of the error of the recorded median transit time.

    The error is relative to the true median. It is the sampling error that a method with all
    identities would have; nan without links.
    """
    errors = [
        abs(recorded_link.transit.q50 - link.transit.q50)
        / max(abs(link.transit.q50), TRANSIT_FLOOR_SECONDS)
        for link, recorded_link in zip(
            truth.links, recorded_medians(events, truth).links, strict=True
        )
        if link.relation != "visible" and link.transitions
    ]
    return float(np.median(errors)) if errors else float("nan")
