"""Score of a learned topology, and of predictions made with it, against the ground truth."""

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
"""Largest distance between the centres of matching zones, fraction of the image."""
COVERED_SDS = 1.96
"""An error within this many stated standard deviations is covered; 95 % should be."""
TRANSIT_FLOOR_SECONDS = 1.0
"""Errors of transit times shorter than this are relative to it; near 0 a ratio means nothing."""
PROBABILITY_FLOOR = 1e-6
"""Least probability in the log loss: an outcome stated as impossible costs 13.8 nats."""


class Score(Struct, frozen=True):
    """Counts and errors of a topology; shares of nothing are 1.0 (nothing missed), errors of
    nothing nan.
    """

    cameras: int
    cameras_right: int
    """Cameras with exactly the true number of zones, all of them matched."""
    zones_true: int
    zones_learned: int
    zones_matched: int
    links_true: int
    """True links (unseen and overlapped) that were walked at all."""
    links_learned: int
    links_found: int
    links_right: int
    """Learned links that are true ones."""
    relations_right: int
    """Right links with the true relation (unseen or overlapped)."""
    mode_error: float
    """Median over the right links of |learned - true| / max(|true|, 1 s) of the mode of transit
    times.
    """
    mean_error: float
    """As `mode_error`, for the mean of transit times."""
    median_error: float
    """As `mode_error`, for the median of transit times."""
    median_error_mean: float
    """Mean of the errors of the medians, which also counts links that are far off."""
    median_covered: float
    """Share of the right links whose true median is within `COVERED_SDS` stated standard errors.

    It is nan without any.
    """
    mean_covered: float
    """As `median_covered`, for the mean of transit times."""
    pairs_true: int
    pairs_learned: int
    pairs_right: int
    """Learned pairs of cameras that are related in truth."""
    pair_relations_right: int
    """Right pairs of cameras with the true relation."""
    pairs_walked: int
    """Pairs of cameras that were learned, or walked between with both ends recorded."""
    links_false: int
    """Learned links that are not true ones."""

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
        """Harmonic mean of `link_precision` and `link_recall`."""
        both = self.link_precision + self.link_recall
        return 2 * self.link_precision * self.link_recall / both if both else 0.0

    @property
    def relation_right(self) -> float:
        """Share of `pairs_walked` that are learned with their true relation."""
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
        """Harmonic mean of `pair_precision` and `pair_recall`."""
        both = self.pair_precision + self.pair_recall
        return 2 * self.pair_precision * self.pair_recall / both if both else 0.0

    def text(self) -> str:
        """Return a few lines for people."""
        return (
            f"zones    {self.zones_matched} of {self.zones_true} found, {self.zones_learned} "
            f"learned; {self.cameras_right} of {self.cameras} cameras with all zones right\n"
            f"links    {self.links_found} of {self.links_true} found (recall "
            f"{self.link_recall:.2f}), {self.links_right} of {self.links_learned} learned true "
            f"(precision {self.link_precision:.2f}); relation right in {self.relations_right}\n"
            f"transit  median error {_percent(self.mode_error)} (mode),"
            f" {_percent(self.mean_error)} (mean)\n"
            f"pairs    {self.pairs_right} of {self.pairs_true} found (recall "
            f"{self.pair_recall:.2f}), {self.pairs_learned} learned (precision "
            f"{self.pair_precision:.2f}); overlapped or unseen right in {self.pair_relations_right}"
        )


class PredictionScore(Struct, frozen=True):
    """Score of predictions of the next camera, over exits that belong to an object."""

    exits: int
    """Number of exits scored."""
    followed: int
    """Number of them whose object was recorded again."""
    top1: float
    """Share of the followed exits whose next camera had the highest probability."""
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

    def text(self) -> str:
        """Return one line for people."""
        return (
            f"{self.exits} exits, {self.followed} seen again: next camera right {self.top1:.3f},"
            f" among the first three {self.top3:.3f}; log loss {self.log_loss:.3f}"
        )


def score(topology: Topology, truth: Truth, tolerance: float = ZONE_TOLERANCE) -> Score:
    """Compare a topology with the ground truth, at the level of zones; links through a view do not
    count.
    """
    match = match_zones(topology.zones, truth.zones, tolerance)

    # Zones.
    true_count, learned_count = (_per_camera(zones) for zones in (truth.zones, topology.zones))
    matched_count = _per_camera([zone for zone in truth.zones if zone.id in match])

    # Links.
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

    # Pairs of cameras.
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
    """Return learned minus true clock offset of each learned camera, seconds.

    Only differences between clocks can be learned, so the median error is subtracted from all.
    """
    error = {c.id: c.clock_offset - truth.clock_offsets.get(c.id, 0.0) for c in topology.cameras}
    gauge = float(np.median(list(error.values()))) if error else 0.0
    return {camera: value - gauge for camera, value in error.items()}


def match_zones(
    learned: Sequence[Zone], true: Sequence[TrueZone], tolerance: float
) -> dict[str, str]:
    """Return true zone -> learned zone, one to one within a camera, least total distance
    (Hungarian).

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
    """Return for each exit of an object the index of the entry where it appears next; otherwise
    -1.
    """

    # Entries of each walker, by number of the passage.
    entries: dict[int, list[tuple[int, int]]] = {}
    for index, (event, who, number) in enumerate(
        zip(events, truth.identity, truth.passage, strict=True)
    ):
        if who != CLUTTER and event.kind == "entry":
            entries.setdefault(who, []).append((number, index))
    for passages in entries.values():
        passages.sort()

    # The first entry after each exit.
    result = []
    for event, who, number in zip(events, truth.identity, truth.passage, strict=True):
        later = []
        if event.kind == "exit":
            later = [index for n, index in entries.get(who, []) if n > number]
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
    following = next_entries(events, truth)
    exits = [index for index, event in enumerate(events) if event.kind == "exit"]

    # Compare each prediction with it.
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
                f"the prediction for {prediction.camera} at {prediction.t} is not for exit line "
                f"{index + 1}"
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

    # Average over the exits.
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
    """Likeliest outcome of an exit: its probability, whether it happened, whether the exit was
    clutter.
    """

    stated: float
    happened: bool
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
        [guess.stated for guess in guesses], [guess.happened for guess in guesses]
    )


def _by_camera(prediction: Prediction) -> dict[str, float]:
    """Return camera -> probability of being next."""
    result: dict[str, float] = {}
    for choice in prediction.next_:
        result[choice.camera] = result.get(choice.camera, 0.0) + choice.probability
    return result


def _within(prediction: Prediction, entry: Event, zone: str | None) -> list[bool]:
    """Return [whether the entry is in the stated window of its zone]; [] if its camera is not
    stated.

    Without a zone it is the window of the camera's likeliest zone.
    """
    named = [choice for choice in prediction.next_ if choice.camera == entry.camera]
    for choice in [choice for choice in named if choice.zone == zone] or named:
        return [choice.q10 <= entry.t - prediction.t <= choice.q90]
    return []


def _per_camera(zones: Sequence[Zone] | Sequence[TrueZone]) -> dict[str, int]:
    """Return camera -> number of zones."""
    result: dict[str, int] = {}
    for zone in zones:
        result[zone.camera] = result.get(zone.camera, 0) + 1
    return result


def _projected(links: list[TrueLink], match: dict[str, str]) -> dict[tuple[str, str], TrueLink]:
    """Return the true links between learned zones; where several coincide, the one walked most."""
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
    """Return the median (or ``together``) of the relative errors of a figure of transit times."""

    def value(transit: Transit) -> float:
        return float(getattr(transit, figure))

    errors = [
        abs(value(link.transit) - value(true.transit))
        / max(abs(value(true.transit)), TRANSIT_FLOOR_SECONDS)
        for link, true in right
    ]
    return float(together(errors)) if errors else math.nan


def _covered(right: list[tuple[Link, TrueLink]], figure: str) -> float:
    """Return the share of right links whose true ``figure`` is within `COVERED_SDS` stated
    errors.
    """
    covered = [
        abs(getattr(link.transit, figure) - getattr(true.transit, figure)) <= COVERED_SDS * sd
        for link, true in right
        if (sd := getattr(link.transit, f"{figure}_sd")) is not None
    ]
    return float(np.mean(covered)) if covered else math.nan


def _share(part: int, whole: int) -> float:
    """Return part / whole, 1.0 of nothing."""
    return part / whole if whole else 1.0


def _percent(value: float) -> str:
    """Return a share in percent, "-" for nan."""
    return "-" if math.isnan(value) else f"{100 * value:.0f} %"
