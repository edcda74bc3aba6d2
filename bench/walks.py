"""Measure walks on real networks with known identities: which events are of one object?

    python -m bench walks [--data FOLDER] [--networks a,b] [--jobs 2] [--json FILE]

Networks and cut are those of `bench real`. The first 70 % of the events are learned. Every entry is
then matched with earlier passages, as `camtopod predict --walks` does, and entries after the cut
are scored. A true walk consists of passages of one identity, each of which begins within the lag
window of the end of those before.

A match makes a claim if its best passage has a probability above one half; the table shows how many
claims there are, how many are right, and their mean probability. The calibration error is that of
the probabilities that an entry belongs to each true walk: where views overlap, a match divides its
probability among the passages of one object. Walks are compared by pairs of passages after the cut
(pairwise precision and recall).

``at once`` are the matches at the entry, ``after 10 s`` the revised ones. ``told`` is an oracle
that is given the identities before the cut, as for ``who`` of `bench real`. ``nearest`` continues
the newest exit of another camera.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from msgspec import Struct
from scipy.optimize import linear_sum_assignment

from bench.support.figures import line_of
from bench.support.match_figures import oracle_odds
from bench.support.parts import networks_parser, results_of
from bench.support.real_figures import calibration_error
from bench.support.recordings import Recording, load
from camtopod.learn.recording import learn_topology
from camtopod.predict import Predictor, Walks
from camtopod.records import Event, Match, Topology

Pairs = set[tuple[str, str]]
"""Pairs of tracks that are of one walk."""


class Figures(Struct):
    """Figures of one way to find walks.

    said, right: claims, and those that are right.
    sure: mean probability of the claims; nan without probabilities.
    error: calibration error of the probabilities by true walk; nan without probabilities.
    precision, recall: of pairs of passages.
    """

    said: int
    right: int
    sure: float
    error: float
    precision: float
    recall: float


class Result(Struct):
    """Figures of one network by way, and what there is to find."""

    name: str
    entries: int
    continued: int
    """Entries that continue a walk."""
    ways: dict[str, Figures]


def main(argv: Sequence[str]) -> int:
    """Measure, print the table and return the exit status."""
    results = results_of(networks_parser(__name__, __doc__).parse_args(argv), measure)
    if results:
        print(f"{'network':20}{'way':14}{'entries':>9}{'continue':>10}{'said':>7}", end="")
        print(f"{'right':>7}{'share':>7}{'sure':>6}{'calibration':>13}{'pairs: P':>10}{'R':>6}")
    for result in results:
        for way, f in result.ways.items():
            print(f"{result.name:20}{way:14}{result.entries:9}{result.continued:10}", end="")
            print(f"{f.said:7}{f.right:7}{f.right / max(f.said, 1):7.2f}{f.sure:6.2f}", end="")
            print(f"{f.error:13.3f}{f.precision:10.2f}{f.recall:6.2f}")
        for way, f in result.ways.items():
            print(line_of(f"{result.name}, {way}, said", f.said))
            print(line_of(f"{result.name}, {way}, right", f.right))
    return 0


def measure(folder: Path) -> Result:
    """Learn one network, match its entries and score the walks."""
    recording = load(folder)
    topology = learn_topology(event for event in recording.events if event.t < recording.cut)
    walk_of, continuations = true_walks(recording)
    entries = {
        str(event.track)
        for event in recording.events
        if event.kind == "entry" and event.t >= recording.cut and str(event.track) in walk_of
    }
    first, later = matches(topology, recording.events)
    truth = pairs(walk_of, entries)
    ways = {
        "at once": scored(first, walk_of, entries, truth),
        "after 10 s": scored(later, walk_of, entries, truth),
        "told": compared(oracle_edges(topology, recording), walk_of, entries, truth),
        "nearest": compared(nearest_edges(recording), walk_of, entries, truth),
    }
    return Result(recording.name, len(entries), len(entries & continuations), ways)


def true_walks(recording: Recording) -> tuple[dict[str, str], set[str]]:
    """Return the true walk of each track, and the tracks that continue one."""
    walk_of: dict[str, str] = {}
    continuations: set[str] = set()
    for passages in recording.by_identity:
        until, walk = -np.inf, ""
        for passage in passages:
            if passage.begin - until <= recording.window:
                continuations.add(passage.track)
            else:
                walk = passage.track
            walk_of[passage.track] = walk
            until = max(until, passage.end)
    return walk_of, continuations


def matches(
    topology: Topology, events: Iterable[Event]
) -> tuple[dict[str, Match], dict[str, Match]]:
    """Return the matches by track: given at the entry, and the last ones."""
    walks = Walks(topology)
    first: dict[str, Match] = {}
    later: dict[str, Match] = {}
    for event in events:
        later |= {str(match.track): match for match in walks.revised(event.t)}
        match = walks.observe(event)
        if match is not None:
            first[str(match.track)] = later[str(match.track)] = match
    return first, later


def pairs(walk_of: Mapping[str, str], entries: set[str]) -> Pairs:
    """Return all pairs of entries (tracks) that are of one walk."""
    members = defaultdict(list)
    for track in sorted(entries):
        members[walk_of.get(track, track)].append(track)
    return {pair for tracks in members.values() for pair in combinations(tracks, 2)}


def scored(
    matches_of: Mapping[str, Match], walk_of: Mapping[str, str], entries: set[str], truth: Pairs
) -> Figures:
    """Score matches by track."""
    chances: list[float] = []
    hits: list[bool] = []
    claims: list[float] = []
    right = 0
    for track in sorted(entries):
        match = matches_of[track]
        chance: dict[str, float] = defaultdict(float)
        for candidate in match.from_:
            before = str(candidate.track)
            chance[walk_of.get(before, before)] += candidate.probability
        chances += chance.values()
        hits += [walk == walk_of[track] for walk in chance]
        if match.from_ and match.from_[0].probability > 0.5:
            claims.append(match.from_[0].probability)
            right += walk_of.get(str(match.from_[0].track)) == walk_of[track]
    names = {track: matches_of[track].walk for track in entries}
    error = sure = float("nan")
    if chances:
        error = calibration_error(chances, hits)
    if claims:
        sure = float(np.mean(claims))
    precision, recall = _precision_and_recall(pairs(names, entries), truth)
    return Figures(len(claims), right, sure, error, precision, recall)


def compared(
    edges: Mapping[str, str], walk_of: Mapping[str, str], entries: set[str], truth: Pairs
) -> Figures:
    """Score edges: by track of an entry, the track of the passage that it continues."""
    names: dict[str, str] = {}
    for track, before in edges.items():  # in order of time
        names[track] = names.get(before, before)
    claims = [track for track in entries if track in edges]
    right = sum(walk_of.get(edges[track]) == walk_of[track] for track in claims)
    precision, recall = _precision_and_recall(pairs(names, entries), truth)
    return Figures(len(claims), right, float("nan"), float("nan"), precision, recall)


def oracle_edges(topology: Topology, recording: Recording) -> dict[str, str]:
    """Return the edges of the assignment by the oracle's odds, after the cut."""
    late = [event for event in recording.events if event.t >= recording.cut]
    exits = [event for event in late if event.kind == "exit"]
    entries = [event for event in late if event.kind == "entry"]
    predictor = Predictor(topology)
    zones = {
        str(event.track): predictor.zone_id_of(event) or ""
        for event in recording.events
        if event.kind == "exit"
    }
    odds = oracle_odds(recording, exits, entries, zones)
    rows, columns = linear_sum_assignment(np.maximum(odds, 0.0), maximize=True)
    before = {
        column: row for row, column in zip(rows, columns, strict=True) if odds[row, column] > 0
    }
    return {
        str(entries[column].track): str(exits[before[column]].track) for column in sorted(before)
    }


def nearest_edges(recording: Recording) -> dict[str, str]:
    """Return the edges from the newest exit of another camera, each exit once."""
    edges: dict[str, str] = {}
    exits: list[Event] = []
    for event in recording.events:
        if event.kind == "exit":
            exits.append(event)
            continue
        exits = [exit_ for exit_ in exits if event.t - exit_.t <= recording.window]
        elsewhere = [exit_ for exit_ in exits if exit_.camera != event.camera]
        if elsewhere:
            edges[str(event.track)] = str(elsewhere[-1].track)
            exits.remove(elsewhere[-1])
    return edges


def _precision_and_recall(claims: Pairs, truth: Pairs) -> tuple[float, float]:
    """Return precision and recall of the pairs that are claimed to be of one walk."""
    right = len(claims & truth)
    return right / max(len(claims), 1), right / max(len(truth), 1)
