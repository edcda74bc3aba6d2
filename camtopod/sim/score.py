"""How near a learned topology, and predictions made with it, come to the truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct
from scipy.optimize import linear_sum_assignment

from camtopod.records import Event, Link, Prediction, Topology, Transit, Zone
from camtopod.sim.calibration import calibration_error, calibration_floor
from camtopod.sim.truth import CLUTTER, TrueLink, TrueZone, Truth

ZONE_TOLERANCE = 0.1
"""A learned zone is a true one when their centres are at most this far apart, fraction of the
image.
"""
COVERED_SDS = 1.96
"""An error within so many stated standard deviations is covered; 95 % should be."""
TRANSIT_FLOOR_SECONDS = 1.0
"""Errors of shorter transit times are relative to this, as a fraction of next to nothing says
nothing.
"""
PROBABILITY_FLOOR = 1e-6
"""Least probability in the log loss: an outcome held impossible costs 13.8 nats, not infinitely
many.
"""


class Score(Struct, frozen=True):
    """Counts and errors; shares of nothing are 1.0 (nothing missed), errors of nothing are nan."""

    cameras: int
    cameras_right: int
    """Cameras with exactly the true number of zones, all of them matched."""
    zones_true: int
    zones_learned: int
    zones_matched: int
    links_true: int
    """Unseen and overlapped links that were walked at all."""
    links_learned: int
    links_found: int
    links_right: int
    """Learned links that are true ones."""
    relations_right: int
    """Of these, how many have the true relation (unseen or overlapped)."""
    mode_error: float
    """Median over the right links of |learned - true| / max(|true|, 1 s) of the transit times'
    modes.
    """
    mean_error: float
    median_error: float
    """The same of the medians."""
    median_error_mean: float
    """Mean of the medians' errors: it counts the links that are far off, too."""
    median_covered: float
    """Share of the right links with the true median within `COVERED_SDS` stated standard errors;
    nan without any.
    """
    mean_covered: float
    """The same of the means."""
    pairs_true: int
    pairs_learned: int
    pairs_right: int
    """Learned pairs of cameras that are related in truth."""
    pair_relations_right: int
    pairs_walked: int
    """Pairs of cameras that somebody walked between, both ends recorded, or that were learned."""
    links_false: int
    """Learned links that are none in truth."""

    @property
    def link_precision(self) -> float:
        """Share of the learned links that are true ones."""
        return _share(self.links_right, self.links_learned)

    @property
    def link_recall(self) -> float:
        """Share of the true links that were found."""
        return _share(self.links_found, self.links_true)

    @property
    def link_f1(self) -> float:
        """Harmonic mean of precision and recall."""
        both = self.link_precision + self.link_recall
        return 2 * self.link_precision * self.link_recall / both if both else 0.0

    @property
    def relation_right(self) -> float:
        """Share of the pairs of cameras, walked or learned, that are learned with their true
        relation.
        """
        return _share(self.pair_relations_right, self.pairs_walked)

    @property
    def pair_precision(self) -> float:
        """Share of the learned pairs of cameras that are related in truth."""
        return _share(self.pairs_right, self.pairs_learned)

    @property
    def pair_recall(self) -> float:
        """Share of the pairs of cameras related in truth that were learned."""
        return _share(self.pairs_right, self.pairs_true)

    @property
    def pair_f1(self) -> float:
        """Harmonic mean of the two."""
        both = self.pair_precision + self.pair_recall
        return 2 * self.pair_precision * self.pair_recall / both if both else 0.0

    def text(self) -> str:
        """A few lines for a person."""
        return (
            f"zones    {self.zones_matched} of {self.zones_true} found, {self.zones_learned} learned;"
            f" {self.cameras_right} of {self.cameras} cameras all right\n"
            f"links    {self.links_found} of {self.links_true} found (recall {self.link_recall:.2f}),"
            f" {self.links_right} of {self.links_learned} learned true (precision {self.link_precision:.2f});"
            f" relation right in {self.relations_right}\n"
            f"transit  median error {_percent(self.mode_error)} (most popular time),"
            f" {_percent(self.mean_error)} (mean)\n"
            f"pairs    {self.pairs_right} of {self.pairs_true} found (recall {self.pair_recall:.2f}),"
            f" {self.pairs_learned} learned (precision {self.pair_precision:.2f});"
            f" overlapped or unseen right in {self.pair_relations_right}"
        )


class PredictionScore(Struct, frozen=True):
    """How often the next camera was named, over exits that belong to somebody."""

    exits: int
    """Exits scored."""
    followed: int
    """Of these, how many objects were recorded again."""
    top1: float
    """Share of the followed ones whose next camera had the highest probability."""
    top3: float
    log_loss: float
    """Mean of -ln(probability of what happened: that camera, or not seen again) over all exits,
    nats.
    """
    calibration_error: float = math.nan
    """Expected calibration error of all stated probabilities, that of leaving included. Most of
    them are next to 0, where nobody is far off."""
    first_calibration_error: float = math.nan
    """The same of the first guess alone: the likeliest outcome, which may be leaving."""
    first_calibration_floor: float = math.nan
    """What chance would make of that on as many exits if every probability were right."""
    first_calibration_error_all: float = math.nan
    """The same over all exits, those of nobody too, after which nobody comes: who predicts cannot
    know which they are, so over the others alone what is right over all looks too careful."""
    window_coverage: float = math.nan
    """Share of the followed ones, next camera named at all, that came between the stated q10 and
    q90.
    """

    def text(self) -> str:
        """A line for a person."""
        return (
            f"{self.exits} exits, {self.followed} seen again: next camera right {self.top1:.3f},"
            f" among the first three {self.top3:.3f}; log loss {self.log_loss:.3f}"
        )


def score(topology: Topology, truth: Truth, tolerance: float = ZONE_TOLERANCE) -> Score:
    """Hold a topology against the truth. Links count at the level of zones, those through a view do
    not.
    """
    match = match_zones(topology.zones, truth.zones, tolerance)
    true_count, learned_count = (_per_camera(zones) for zones in (truth.zones, topology.zones))
    matched_count = _per_camera([zone for zone in truth.zones if zone.id in match])
    true_links = _projected([link for link in truth.links if link.relation != "visible"], match)
    learned = [link for link in topology.links if link.relation != "visible"]
    right = [
        (link, true_links[link.from_, link.to])
        for link in learned
        if (link.from_, link.to) in true_links
    ]
    keys = {(link.from_, link.to) for link in learned}
    walked = [link for link in truth.links if link.relation != "visible" and link.transitions > 0]
    camera_of = {zone.id: zone.camera for zone in truth.zones}
    walked_pairs = {tuple(sorted((camera_of[link.from_], camera_of[link.to]))) for link in walked}
    learned_pairs = {pair.cameras: pair.relation for pair in topology.pairs}
    true_pairs = {pair.cameras: pair.relation for pair in truth.pairs}
    expected = walked_pairs if truth.links else true_pairs.keys()
    both = learned_pairs.keys() & true_pairs.keys()
    return Score(
        cameras=len(truth.cameras),
        cameras_right=sum(
            true_count.get(c, 0) == learned_count.get(c, 0) == matched_count.get(c, 0)
            for c in truth.cameras
        ),
        zones_true=len(truth.zones),
        zones_learned=len(topology.zones),
        zones_matched=len(match),
        links_true=len(walked),
        links_learned=len(learned),
        links_found=sum((match.get(link.from_), match.get(link.to)) in keys for link in walked),
        links_right=len(right),
        relations_right=sum(link.relation == true.relation for link, true in right),
        mode_error=_error(right, "mode"),
        mean_error=_error(right, "mean"),
        median_error=_error(right, "q50"),
        median_error_mean=_error(right, "q50", np.mean),
        median_covered=_covered(right, "q50"),
        mean_covered=_covered(right, "mean"),
        pairs_true=len(true_pairs),
        pairs_learned=len(learned_pairs),
        pairs_right=len(both),
        pair_relations_right=sum(learned_pairs[pair] == true_pairs[pair] for pair in both),
        pairs_walked=len(expected | learned_pairs.keys()),
        links_false=len(learned) - len(right),
    )


def clock_errors(topology: Topology, truth: Truth) -> dict[str, float]:
    """Learned minus true clock offset of each learned camera, seconds.

    Only differences between clocks can be learned, so the median of the errors is taken out of all
    of them.
    """
    error = {c.id: c.clock_offset - truth.clock_offsets.get(c.id, 0.0) for c in topology.cameras}
    gauge = float(np.median(list(error.values()))) if error else 0.0
    return {camera: value - gauge for camera, value in error.items()}


def match_zones(
    learned: Sequence[Zone], true: Sequence[TrueZone], tolerance: float
) -> dict[str, str]:
    """True zone -> learned zone, one to one within each camera, least total distance (Hungarian).

    A learned zone without positions stands for the whole camera, so for all its true zones.
    """
    result: dict[str, str] = {}
    for camera in sorted({zone.camera for zone in true}):
        ours = [zone for zone in learned if zone.camera == camera]
        theirs = [zone for zone in true if zone.camera == camera]
        whole = [zone for zone in ours if zone.x is None]
        placed = [zone for zone in ours if zone.x is not None]
        if whole:
            result |= {zone.id: whole[0].id for zone in theirs}
        elif placed and theirs[0].x is not None:
            a = np.array([(zone.x, zone.y) for zone in theirs], dtype=float)
            b = np.array([(zone.x, zone.y) for zone in placed], dtype=float)
            distance = np.linalg.norm(a[:, None] - b[None], axis=2)
            cost = np.where(distance <= tolerance, distance, 1e3)
            rows, columns = linear_sum_assignment(cost)
            near = distance[rows, columns] <= tolerance
            result |= {
                theirs[i].id: placed[j].id for i, j in zip(rows[near], columns[near], strict=True)
            }
    return result


def next_entries(events: Sequence[Event], truth: Truth) -> list[int]:
    """For each event, if it is somebody's exit: index of the entry with which they appear next;
    else -1.
    """
    entries: dict[int, list[tuple[int, int]]] = {}
    for index, (event, who, number) in enumerate(
        zip(events, truth.identity, truth.passage, strict=True)
    ):
        if who != CLUTTER and event.kind == "entry":
            entries.setdefault(who, []).append((number, index))
    for passages in entries.values():
        passages.sort()
    result = []
    for event, who, number in zip(events, truth.identity, truth.passage, strict=True):
        later = (
            [index for n, index in entries.get(who, []) if n > number]
            if event.kind == "exit"
            else []
        )
        result.append(later[0] if later else -1)
    return result


def score_predictions(
    predictions: Iterable[Prediction],
    events: Sequence[Event],
    truth: Truth,
    since: float = -math.inf,
    zone_of: Callable[[Event], str | None] | None = None,
) -> PredictionScore:
    """Score one prediction for each exit line of ``events``, in order; exits before ``since`` do
    not count.

    ``zone_of`` names the zone of an entry, so that its own time window is looked at; without it,
    that of the likeliest zone of its camera is. Raises ValueError when the predictions do not
    belong to these events.
    """
    following = next_entries(events, truth)
    exits = [index for index, event in enumerate(events) if event.kind == "exit"]
    top1 = top3 = followed = scored = 0
    loss = 0.0
    stated: list[float] = []
    happened: list[bool] = []
    firsts: list[_Guess] = []
    within: list[bool] = []
    for index, prediction in zip(exits, predictions, strict=True):
        event = events[index]
        if prediction.camera != event.camera or abs(prediction.t - event.t) > 1e-5:
            raise ValueError(
                f"the prediction for {prediction.camera} at {prediction.t} is not for exit line {index + 1}"
            )
        if event.t < since:
            continue
        entry = events[following[index]] if following[index] >= 0 else None
        by_camera = _by_camera(prediction)
        firsts.append(_first(prediction.leave, by_camera, entry, truth.identity[index] == CLUTTER))
        if firsts[-1].clutter:
            continue
        scored += 1
        if entry is not None:
            ranked = sorted(by_camera, key=lambda name: -by_camera[name])
            followed += 1
            top1 += ranked[:1] == [entry.camera]
            top3 += entry.camera in ranked[:3]
            within += _within(prediction, entry, zone_of(entry) if zone_of else None)
        outcome = prediction.leave if entry is None else by_camera.get(entry.camera, 0.0)
        loss -= math.log(max(outcome, PROBABILITY_FLOOR))
        stated += [*by_camera.values(), prediction.leave]
        happened += [
            *(entry is not None and camera == entry.camera for camera in by_camera),
            entry is None,
        ]
    somebody = [guess for guess in firsts if not guess.clutter]
    return PredictionScore(
        exits=scored,
        followed=followed,
        top1=_share(top1, followed),
        top3=_share(top3, followed),
        log_loss=loss / scored if scored else math.nan,
        calibration_error=calibration_error(stated, happened),
        first_calibration_error=_calibration_error(somebody),
        first_calibration_floor=calibration_floor([guess.stated for guess in somebody]),
        first_calibration_error_all=_calibration_error(firsts),
        window_coverage=float(np.mean(within)) if within else math.nan,
    )


class _Guess(NamedTuple):
    """The likeliest outcome of an exit: its probability, whether it came so, whether the exit
    belonged to nobody.
    """

    stated: float
    happened: bool
    clutter: bool


def _first(leave: float, by_camera: dict[str, float], entry: Event | None, clutter: bool) -> _Guess:
    camera = max(by_camera, key=lambda name: by_camera[name], default=None)
    if camera is None or leave > by_camera[camera]:
        return _Guess(leave, entry is None, clutter)
    return _Guess(by_camera[camera], entry is not None and entry.camera == camera, clutter)


def _calibration_error(guesses: Sequence[_Guess]) -> float:
    return calibration_error(
        [guess.stated for guess in guesses], [guess.happened for guess in guesses]
    )


def _by_camera(prediction: Prediction) -> dict[str, float]:
    result: dict[str, float] = {}
    for choice in prediction.next_:
        result[choice.camera] = result.get(choice.camera, 0.0) + choice.probability
    return result


def _within(prediction: Prediction, entry: Event, zone: str | None) -> list[bool]:
    """Whether the entry came in the window of its zone, else of the likeliest of its camera; empty:
    not named.
    """
    named = [choice for choice in prediction.next_ if choice.camera == entry.camera]
    for choice in [choice for choice in named if choice.zone == zone] or named:
        return [choice.q10 <= entry.t - prediction.t <= choice.q90]
    return []


def _per_camera(zones: Sequence[Zone] | Sequence[TrueZone]) -> dict[str, int]:
    result: dict[str, int] = {}
    for zone in zones:
        result[zone.camera] = result.get(zone.camera, 0) + 1
    return result


def _projected(links: list[TrueLink], match: dict[str, str]) -> dict[tuple[str, str], TrueLink]:
    """True links between learned zones; where several fall together, the one walked most."""
    result: dict[tuple[str, str], TrueLink] = {}
    for link in sorted(links, key=lambda link: link.transitions):
        if link.from_ in match and link.to in match:
            result[match[link.from_], match[link.to]] = link
    return result


def _error(
    right: list[tuple[Link, TrueLink]],
    figure: str,
    together: Callable[[list[float]], np.floating[Any]] = np.median,
) -> float:
    def value(transit: Transit) -> float:
        return float(getattr(transit, figure))

    errors = [
        abs(value(link.transit) - value(true.transit))
        / max(abs(value(true.transit)), TRANSIT_FLOOR_SECONDS)
        for link, true in right
    ]
    return float(together(errors)) if errors else math.nan


def _covered(right: list[tuple[Link, TrueLink]], figure: str) -> float:
    covered = [
        abs(getattr(link.transit, figure) - getattr(true.transit, figure)) <= COVERED_SDS * sd
        for link, true in right
        if (sd := getattr(link.transit, f"{figure}_sd")) is not None
    ]
    return float(np.mean(covered)) if covered else math.nan


def _share(part: int, whole: int) -> float:
    return part / whole if whole else 1.0


def _percent(value: float) -> str:
    return "-" if math.isnan(value) else f"{100 * value:.0f} %"
