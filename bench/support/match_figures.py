"""Score of matching exits and entries on a real recording, beside an oracle's.

The oracle is given the identities before the cut: of each zone's departures, the shares of the next
cameras, and the true lags.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from bench.support.real_figures import LEAVE
from bench.support.recordings import Recording
from camtopod.arrays import Floats
from camtopod.client import Gate
from camtopod.records import Event, Prediction, Topology

DEPARTURES_MIN = 5
"""Least departures for a zone's own shares in `oracle_odds`; with fewer they are its camera's."""


def who_figures(
    topology: Topology, predictions: Sequence[Prediction], recording: Recording
) -> tuple[float, float]:
    """Return F1 of matching exits and entries after the cut: by `Gate.affinity`, and by the oracle.

    Matches are the edges of an assignment; they are compared with true transitions.
    """
    late = [event for event in recording.events if event.t >= recording.cut]
    exits = [event for event in late if event.kind == "exit"]
    entries = [event for event in late if event.kind == "entry"]
    row, column = _numbered(exits), _numbered(entries)
    true = {
        (row[passage.track], column[passage.next_.track])
        for passage in recording.passages.values()
        if passage.next_ is not None and passage.next_.camera != passage.camera
        if passage.track in row and passage.next_.track in column
    }
    zones = {str(one.track): one.zone or "" for one in predictions}
    ours, told = (
        np.asarray(Gate(topology).affinity(exits, entries)),
        oracle_odds(recording, exits, entries, zones),
    )
    return _edges_f1(ours, true), _edges_f1(told, true)


def oracle_odds(
    recording: Recording, exits: Sequence[Event], entries: Sequence[Event], zones: Mapping[str, str]
) -> Floats:
    """Return log odds (exits, entries), as `Gate.affinity` has them, from identities before the
    cut.

    Shares are by the zone of departure (``zones``, by track), lags are kernels around the true
    ones, and rates from outside are the true ones.
    """
    counts, lags = (
        defaultdict[str, Counter[str]](Counter),
        defaultdict[tuple[str, str], list[float]](list),
    )
    came, linked = Counter[str](), Counter[str]()
    for track, passage in recording.passages.items():
        following = passage.next_
        elsewhere = following is not None and following.camera != passage.camera
        if passage.came < recording.cut:
            came[passage.camera] += 1
        if following is not None and elsewhere and following.came < recording.cut:
            linked[following.camera] += 1
        if passage.left >= recording.cut:
            continue
        outcome = (
            following.camera
            if following is not None and elsewhere and following.came < recording.cut
            else LEAVE
        )
        for place in (zones.get(track, ""), f"{passage.camera}/"):
            counts[place][outcome] += 1
        if outcome != LEAVE:
            lags[passage.camera, outcome].append(passage.lag)

    # Odds of each exit with the entries of each camera.
    span = recording.cut - min(passage.came for passage in recording.passages.values())
    t, camera = (
        np.array([entry.t for entry in entries]),
        np.array([entry.camera for entry in entries]),
    )
    odds = np.full((len(exits), len(entries)), -np.inf)
    for row, event in enumerate(exits):
        known = counts[zones.get(str(event.track), "")]
        if known.total() < DEPARTURES_MIN:
            known = counts[f"{event.camera}/"]
        total = known.total() + 1
        gone = np.log((known[LEAVE] + 0.5) / total)
        for outcome, number in known.items():
            each = np.array(lags.get((event.camera, outcome), []))
            if outcome == LEAVE or len(each) < 2:
                continue
            width = max(0.5, 1.06 * float(each.std()) * len(each) ** -0.2)
            there = np.flatnonzero(camera == outcome)
            apart = ((t[there] - event.t)[:, None] - each) / width
            density = np.exp(-0.5 * apart**2).sum(axis=1) / (len(each) * width * 2.5066) + 1e-9
            rate = max(came[outcome] - linked[outcome], 1) / span
            odds[row, there] = np.log(number / total) + np.log(density) - np.log(rate) - gone
    return odds


def _edges_f1(odds: Floats, true: set[tuple[int, int]]) -> float:
    """Return F1 of the edges of the likeliest assignment."""
    positive = np.maximum(odds, 0.0)
    edges = {
        (i, j)
        for i, j in zip(*linear_sum_assignment(positive, maximize=True), strict=True)
        if odds[i, j] > 0
    }
    return 2.0 * len(edges & true) / max(1, len(edges) + len(true))


def _numbered(events: Sequence[Event]) -> dict[str, int]:
    """Return the index of each event by track."""
    return {str(event.track): k for k, event in enumerate(events)}
