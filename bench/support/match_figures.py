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

    Matches are the edges of an assignment; they are compared with true transitions. Cameras without
    events before the cut are left out.
    """
    cameras = {camera.id for camera in topology.cameras}
    late = [
        event for event in recording.events if event.t >= recording.cut and event.camera in cameras
    ]
    exits = [event for event in late if event.kind == "exit"]
    entries = [event for event in late if event.kind == "entry"]
    row, column = _numbered(exits), _numbered(entries)
    true = {
        (row[passage.track], column[passage.next_.track])
        for passage in recording.passages.values()
        if passage.next_ is not None and passage.next_.camera != passage.camera
        if passage.track in row and passage.next_.track in column
    }
    zones = {str(prediction.track): prediction.zone or "" for prediction in predictions}
    affinity, odds = (
        np.asarray(Gate(topology).affinity(exits, entries)),
        oracle_odds(recording, exits, entries, zones),
    )
    return _edges_f1(affinity, true), _edges_f1(odds, true)


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
    arrivals, link_arrivals = Counter[str](), Counter[str]()
    for track, passage in recording.passages.items():
        next_passage = passage.next_
        elsewhere = next_passage is not None and next_passage.camera != passage.camera
        if passage.begin < recording.cut:
            arrivals[passage.camera] += 1
        if next_passage is not None and elsewhere and next_passage.begin < recording.cut:
            link_arrivals[next_passage.camera] += 1
        if passage.end >= recording.cut:
            continue
        outcome = (
            next_passage.camera
            if next_passage is not None and elsewhere and next_passage.begin < recording.cut
            else LEAVE
        )
        for place in {zones.get(track) or f"{passage.camera}/", f"{passage.camera}/"}:
            counts[place][outcome] += 1
        if outcome != LEAVE:
            lags[passage.camera, outcome].append(passage.lag)

    # Odds of each exit with the entries of each camera.
    span = recording.cut - min(passage.begin for passage in recording.passages.values())
    t, camera = (
        np.array([entry.t for entry in entries]),
        np.array([entry.camera for entry in entries]),
    )
    odds = np.full((len(exits), len(entries)), -np.inf)
    for row, event in enumerate(exits):
        zone_counts = counts[zones.get(str(event.track), "")]
        if zone_counts.total() < DEPARTURES_MIN:
            zone_counts = counts[f"{event.camera}/"]
        total = zone_counts.total() + 1
        leave_odds = np.log((zone_counts[LEAVE] + 0.5) / total)
        for outcome, number in zone_counts.items():
            transit_times = np.array(lags.get((event.camera, outcome), []))
            if outcome == LEAVE or len(transit_times) < 2:
                continue
            width = max(0.5, 1.06 * float(transit_times.std()) * len(transit_times) ** -0.2)
            columns = np.flatnonzero(camera == outcome)
            apart = ((t[columns] - event.t)[:, None] - transit_times) / width
            density = (
                np.exp(-0.5 * apart**2).sum(axis=1) / (len(transit_times) * width * 2.5066) + 1e-9
            )
            rate = max(arrivals[outcome] - link_arrivals[outcome], 1) / span
            odds[row, columns] = (
                np.log(number / total) + np.log(density) - np.log(rate) - leave_odds
            )
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
