"""Scores of a topology and predictions on a real recording, beside an oracle.

The oracle is a Markov chain on the same zones that is given the identities. It counts the next
camera from each zone before the cut, backed off to its camera's counts and those of all, and takes
its transit times from the true lags.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct

from bench.support.recordings import SPURIOUS_TRANSITIONS_MAX, Passage, Recording, pairs_of
from camtopod.arrays import Floats
from camtopod.records import Prediction, Topology
from camtopod.words import sum_by_camera

LEAVE = "leave"
"""Outcome of an object that leaves the site."""
TELLABLE_NATS = (6.0, 20.0)
"""Levels of evidence above which links count as tellable, nats."""
BACKING = 2.0
"""Weight, in exits, of the camera's shares beside the zone's counts, and of all
beside the camera's.
"""
LAGS_MIN = 9
"""Least lags for a zone's own transit times; with fewer they are its camera's, or everybody's."""
LOSS_FLOOR = 1e-3
"""Added to every outcome's probability before its logarithm is taken."""
CALIBRATION_BINS = 10
"""Bins of the calibration error, of equal mass."""
UNIFORM_SHARE = 0.05
"""Share of each camera's density that is spread over the whole search time."""
SEARCH_RECALLS = (0.8, 0.9, 0.95)
"""Recalls at which the saving of a search is reported."""


class LinkFigures(Struct):
    """Figures of links between cameras."""

    published: int
    right: int
    """Published links that are true."""
    false: int
    true: int
    found: dict[float, int]
    """Right links among those the events can tell, by evidence in nats."""
    can_be_told: dict[float, int]
    """Links the events can tell, by evidence in nats."""
    relations_right: int
    relations: int
    """Camera pairs whose relation is published and clear in the ground truth."""
    transit_error: float
    """Median over the right links of the error of their median, seconds; nan without any."""


class PredictionFigures(Struct):
    """Figures of predictions for the exits after the cut whose lag window is over."""

    exits: int
    log_loss: float
    leave_loss: float
    """Part of the log loss that is about whether the object leaves the site."""
    top1: float
    """Top-1 and top-3 are of all exits, with leaving as an outcome like the others."""
    top3: float
    confidence: list[float]
    """Probability of the first guess, exit by exit."""
    right: list[bool]
    """Whether the first guess was right, exit by exit."""
    coverage: float
    """Share of the lags of objects seen again within q10 to q90; nan if there is none."""
    saved: dict[float, float]
    """By recall, all camera-seconds over those searched; empty without objects to find."""
    leaving: float
    """Mean probability of leaving."""
    left: float
    """Share of the exits whose object was not seen again."""

    @property
    def calibration_error(self) -> float:
        """Calibration error of the first guess."""
        return calibration_error(self.confidence, self.right)


def link_figures(
    topology: Topology, recording: Recording, nats: Mapping[tuple[str, str], float]
) -> LinkFigures:
    """Score the links of a topology; ``nats`` is the evidence for each true link (`tellable`)."""
    true = recording.links()
    frequent_pairs = {
        pair
        for pair, lags in recording.transitions().items()
        if len(lags) > SPURIOUS_TRANSITIONS_MAX
    }
    camera_of = {zone.id: zone.camera for zone in topology.zones}
    medians: dict[tuple[str, str], list[tuple[float, float]]] = defaultdict(list)
    for link in topology.links:
        pair = camera_of[link.from_], camera_of[link.to]
        if pair[0] != pair[1]:
            medians[pair].append((link.transitions + 1e-9, link.transit.q50))
    published = set(medians)
    tellable_pairs = {least: {p for p, n in nats.items() if n >= least} for least in TELLABLE_NATS}

    # Transit times of the right links.
    errors = []
    for pair in published & true.keys():
        weight, median = zip(*medians[pair], strict=True)
        errors.append(abs(np.average(median, weights=weight) - np.median(true[pair])))

    ahead: dict[frozenset[str], list[bool]] = defaultdict(list)
    for pair, lags in true.items():
        ahead[frozenset(pair)] += [lag < 0 for lag in lags]
    clear = {
        pair: np.mean(signs) >= 0.5
        for pair, signs in ahead.items()
        if not 0.25 < np.mean(signs) < 0.75
    }
    relation = {frozenset(pair.cameras): pair.relation == "overlapped" for pair in topology.pairs}
    is_right = [
        bool(relation[pair] == clear[pair])
        for pair in relation.keys() & clear.keys() & pairs_of([*true])
    ]
    return LinkFigures(
        len(published),
        len(published & true.keys()),
        len(published - frequent_pairs),
        len(true),
        {least: len(published & pairs) for least, pairs in tellable_pairs.items()},
        {least: len(pairs) for least, pairs in tellable_pairs.items()},
        sum(is_right),
        len(is_right),
        float(np.median(errors)) if errors else float("nan"),
    )


class Guess(Struct):
    """Prediction of one exit.

    outcomes: probability of each outcome.
    ways: camera, probability, and quantiles of the lag (q10, q50, q90) of each link.
    """

    outcomes: dict[str, float]
    ways: list[tuple[str, float, tuple[float, float, float]]]


class Oracle:
    """A Markov chain that is given the identities (the oracle)."""

    def __init__(self, outcomes: Sequence[str]) -> None:
        self._outcomes = outcomes
        self._counts: dict[str, Counter[str]] = defaultdict(Counter)
        self._lags: dict[tuple[str, str], list[float]] = defaultdict(list)

    def learn(self, zone: str, camera: str, outcome: str, lag: float) -> None:
        """Count one exit and its outcome."""
        for place in (zone, f"{camera}/", ""):
            self._counts[place][outcome] += 1
            if outcome != LEAVE:
                self._lags[place, outcome].append(lag)
        if outcome != LEAVE:
            self._lags["", ""].append(lag)

    def guess(self, zone: str, camera: str) -> Guess:
        """Predict an exit from a zone."""
        shares = {name: 1.0 / len(self._outcomes) for name in self._outcomes}
        for place in ("", f"{camera}/", zone):
            counts, total = self._counts[place], self._counts[place].total()
            shares = {
                name: (counts[name] + BACKING * share) / (total + BACKING)
                for name, share in shares.items()
            }
        ways = [
            (name, share, self._quantiles(zone, camera, name))
            for name, share in shares.items()
            if name != LEAVE
        ]
        return Guess(shares, ways)

    def _quantiles(self, zone: str, camera: str, outcome: str) -> tuple[float, float, float]:
        """Return q10, q50 and q90 of the lag, from the most specific place with enough lags."""
        keys = ((zone, outcome), (f"{camera}/", outcome), ("", outcome))
        lags = next(
            (self._lags[key] for key in keys if len(self._lags.get(key, ())) >= LAGS_MIN), None
        )
        q10, q50, q90 = np.quantile(
            lags or self._lags.get(("", "")) or [0.0, 60.0], (0.1, 0.5, 0.9), method="weibull"
        )
        return float(q10), float(q50), float(q90)


def prediction_figures(
    predictions: Sequence[Prediction], recording: Recording
) -> tuple[PredictionFigures, PredictionFigures] | None:
    """Score our predictions and the oracle's; None if no exit is left to score.

    ``predictions`` are those of every exit, in order.
    """
    outcomes = [*recording.cameras, LEAVE]
    chain, passages = Oracle(outcomes), list[Passage]()
    guesses, oracle_guesses = list[Guess](), list[Guess]()
    for prediction in predictions:
        zone = prediction.zone or f"{prediction.camera}/1"
        passage = recording.passages[str(prediction.track)]
        if prediction.t <= recording.cut - recording.window:
            next_passage = passage.next_
            outcome = LEAVE
            if next_passage is not None and next_passage.begin < recording.cut:
                outcome = next_passage.camera
            chain.learn(zone, prediction.camera, outcome, passage.lag)
        elif recording.cut <= prediction.t <= recording.end - recording.window:
            passages.append(passage)
            shares = {LEAVE: prediction.leave} | sum_by_camera(prediction.next)
            ways = [(w.camera, w.probability, (w.q10, w.q50, w.q90)) for w in prediction.next]
            guesses.append(Guess(shares, ways))
            oracle_guesses.append(chain.guess(zone, prediction.camera))
    if not passages:
        return None
    return (
        _judged(guesses, passages, outcomes, recording.reach),
        _judged(oracle_guesses, passages, outcomes, recording.reach),
    )


def _judged(
    guesses: Sequence[Guess], passages: Sequence[Passage], outcomes: Sequence[str], reach: int
) -> PredictionFigures:
    """Score predictions against the passages that followed, searched for ``reach`` seconds."""
    losses, leave_losses, confidence, cost = [], [], [], []
    right, third, coverage = list[bool](), list[bool](), list[bool]()

    # Loss, ranks, coverage and search of each exit.
    floor = 1.0 + LOSS_FLOOR * len(outcomes)
    for guess, passage in zip(guesses, passages, strict=True):
        outcome = LEAVE if passage.next_ is None else passage.next_.camera
        shares = {name: guess.outcomes.get(name, 0.0) for name in outcomes}
        losses.append(-np.log((shares[outcome] + LOSS_FLOOR) / floor))
        leaves = (shares[LEAVE] + LOSS_FLOOR) / floor
        leave_losses.append(-np.log(leaves if outcome == LEAVE else 1.0 - leaves))
        first = sorted(outcomes, key=lambda name: -shares[name])[:3]
        confidence.append(shares[first[0]])
        right.append(first[0] == outcome)
        third.append(outcome in first)
        if outcome == LEAVE:
            continue
        ways = [(share, quantiles) for camera, share, quantiles in guess.ways if camera == outcome]
        total = sum(share for share, _ in ways)
        if total > 0:
            probability = (
                sum(share * float(_reached(np.array(passage.lag), *q)) for share, q in ways) / total
            )
            coverage.append(0.1 - 1e-9 <= probability <= 0.9 + 1e-9)
        if outcome != passage.camera and passage.lag <= reach - 1:
            cost.append(_searched(guess, passage, outcomes, reach))

    # Savings of a search, against searching all cameras.
    all_seconds = (len(outcomes) - 2) * reach
    saved = {
        recall: all_seconds / max(1.0, float(np.quantile(cost, recall)))
        for recall in SEARCH_RECALLS
        if cost
    }
    return PredictionFigures(
        len(passages),
        float(np.mean(losses)),
        float(np.mean(leave_losses)),
        float(np.mean(right)),
        float(np.mean(third)),
        confidence,
        right,
        float(np.mean(coverage)) if coverage else float("nan"),
        saved,
        float(np.mean([guess.outcomes.get(LEAVE, 0.0) for guess in guesses])),
        float(np.mean([passage.next_ is None for passage in passages])),
    )


def _reached(x: Floats, q10: float, q50: float, q90: float) -> Floats:
    """Return the probability that the lag is at most ``x``.

    It is linear between the quantiles and exponential beyond them.
    """
    q50 = max(q50, q10 + 0.05)
    q90 = max(q90, q50 + 0.05)
    before, after = max((q50 - q10) / 2, 0.1), max((q90 - q50) / 2, 0.1)
    early = 0.1 * np.exp(np.minimum(x - q10, 0.0) / before)
    late = 1.0 - 0.1 * np.exp(-np.maximum(x - q90, 0.0) / after)
    return np.where(
        x < q10, early, np.where(x > q90, late, np.interp(x, (q10, q50, q90), (0.1, 0.5, 0.9)))
    )


def _searched(guess: Guess, passage: Passage, outcomes: Sequence[str], reach: int) -> float:
    """Return the camera-seconds searched, in order of density, until the object is found.

    passage: the passage that ended, whose next one is in reach.
    reach: time after the exit in which every camera is searched, seconds.
    """
    assert passage.next_ is not None
    seconds = np.arange(reach + 1.0)
    density = {
        camera: np.zeros(reach) for camera in outcomes if camera not in (passage.camera, LEAVE)
    }
    for camera, share, quantiles in guess.ways:
        if camera in density:
            cumulative = _reached(seconds, *quantiles)
            mass = np.diff(cumulative)
            mass[0] += cumulative[0]
            density[camera] += share * ((1.0 - UNIFORM_SHARE) * mass + UNIFORM_SHARE / reach)
    level = density[passage.next_.camera][int(max(0.0, passage.lag))]
    levels = np.concatenate([*density.values()])
    return float(np.sum(levels > level) + 0.5 * (np.sum(levels == level) - 1) + 1)


def calibration_error(confidence: Sequence[float], right: Sequence[bool]) -> float:
    """Return the mean distance of confidence from accuracy, in bins of equal mass."""
    order = np.argsort(confidence, kind="stable")
    apart = [
        abs(np.sum(np.take(confidence, rows)) - np.sum(np.take(right, rows)))
        for rows in np.array_split(order, CALIBRATION_BINS)
    ]
    return float(sum(apart) / max(1, len(right)))


def look_figures(predictions: Sequence[Prediction], recording: Recording) -> tuple[float, float]:
    """Return the share of exits after the cut where the camera to look at first is right.

    It is returned for our predictions, and for the zone's most frequent camera by identities before
    the cut.
    """
    cameras_in_view = recording.in_view()
    of_zone: dict[str, Counter[str]] = defaultdict(Counter)
    hits, oracle_hits = list[bool](), list[bool]()
    for prediction in sorted(predictions, key=lambda prediction: prediction.t):
        right = cameras_in_view[str(prediction.track)]
        if not right:
            continue
        zone = prediction.zone or f"{prediction.camera}/"
        if prediction.t < recording.cut:
            for camera in sorted(right):
                of_zone[zone][camera] += 1
                of_zone[f"{prediction.camera}/"][camera] += 1
            continue
        looks = prediction.next if prediction.look is None else prediction.look
        shares = sum_by_camera(way for way in looks if way.camera != prediction.camera)
        frequent = of_zone.get(zone) or of_zone[f"{prediction.camera}/"]
        hits.append(bool(shares) and max(shares, key=lambda camera: shares[camera]) in right)
        oracle_hits.append(bool(frequent) and frequent.most_common(1)[0][0] in right)
    if not hits:
        return float("nan"), float("nan")
    return float(np.mean(hits)), float(np.mean(oracle_hits))


def hand_over_figure(predictions: Sequence[Prediction], recording: Recording) -> float:
    """Return the share of exits where the first passage named in view is of the same object.

    Exits are those after the cut at which another camera sees the object; nan if there are none.
    """
    tracks = recording.under_way()
    late = [p for p in predictions if p.t >= recording.cut and tracks[str(p.track)]]
    right = [p.in_view[0].track in tracks[str(p.track)] for p in late if p.in_view]
    return sum(right) / len(late) if late else float("nan")
