"""Measure one network for `bench.quality`: camtopod in three modes, and every baseline.

The modes are `OURS`: fed event by event (online), as it is served (live), and in one fit (batch).
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Hashable, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Struct

from bench.baselines.anonymous import anonymous
from bench.baselines.closest import LITERAL, LITERAL_SCORE_MIN, closest
from bench.baselines.correlation import correlation
from bench.baselines.crossings import NARROW, WIDE, Candidates, Crossings, candidates, crossings
from bench.baselines.findings import Findings, Ranked, at, rank
from bench.baselines.hawkes import hawkes
from bench.baselines.information import information
from bench.baselines.oracle import oracle_score, recorded_medians, transit_error
from bench.baselines.transfer import transfer
from bench.baselines.zoning import methods
from bench.support.prediction_scores import PredictionScore, clock_errors, score_predictions
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.predict.predictor import Predictor
from camtopod.records import Event, Prediction, Topology, Zone
from camtopod.sim.scoring import Score, match_zones, score
from camtopod.sim.truth import Truth

COVERED_SDS = 1.96
"""An error within this many stated standard deviations is covered; 95 % should be."""
TRAIN_SHARE = 0.7
"""Share of the events that are learned before predictions on the rest are scored."""
WARM_EVENTS = 5000
"""Events before the cut that a predictor observes first; it remembers 2,000 of each kind."""
CLOCK_SECONDS_MAX = 0.5
"""Tolerated error of a clock offset, seconds."""
OURS = ("online", "live", "batch")
"""Modes in which camtopod is measured."""
GROUPS = (*OURS, "baselines")
"""Groups of methods that are measured together."""

LINK_METHODS: dict[str, Callable[..., Any]] = {
    "closest pairs (thesis)": closest,
    "cross-correlation (Makris 2004)": correlation,
    "mutual information (Tieu 2005)": information,
    "transfer entropy (Ito 2011)": transfer,
    "anonymous Markov (least squares)": anonymous,
    "Hawkes process": hawkes,
}
"""Baselines for links, by the name and paper that the tables show."""
TAKE_CANDIDATES = (correlation, information, hawkes)
"""Baselines whose second argument is the candidates."""
TAKE_LAGS = (transfer, anonymous)
"""Baselines whose second argument is the range of lags."""


class Record(Struct, omit_defaults=True):
    """Figures of one method on one network; ``ranked`` by variant, for choosing its threshold."""

    regime: str
    seed: int
    method: str
    seconds: float
    """Processor time, seconds: other work on the machine does not count."""
    figures: dict[str, float | None] = {}
    ranked: dict[str, Ranked] = {}

    def get(self, name: str) -> float:
        """Return a figure; nan if there is none."""
        value = self.figures.get(name)
        return math.nan if value is None else value


def measure(
    group: str,
    regime: str,
    seed: int,
    events: Sequence[Event],
    truth: Truth,
    settings: Settings | None = None,
) -> list[Record]:
    """Return all records of one of `GROUPS`, learned with ``settings`` (default: `Settings`)."""
    if group == "baselines":
        return baselines(regime, seed, events, truth)
    settings = settings or Settings()
    if group == "live":
        topology, forecast, seconds = serve(events, settings)
    else:
        topology, head, seconds = learn(events, Learner(settings, only_last=group == "batch"))
        forecast = predict(head, events)
    figures = network_figures(topology, truth, events)
    figures |= prediction_figures(forecast, events, truth)
    figures |= {
        "events": len(events),
        "events_per_second": len(events) / seconds,
        "versions": topology.version,
    }
    return [Record(regime, seed, group, seconds, _plain(figures))]


def learn(events: Sequence[Event], learner: Learner) -> tuple[Topology, Topology, float]:
    """Learn all events and return the last version, the version at the cut, and processor seconds.

    The version at the cut is made by a copy of the learner that has received `TRAIN_SHARE` of the
    events; its time does not count. Events are fed as `camtopod learn` feeds them.
    """
    head = None
    cut = int(TRAIN_SHARE * len(events))
    aside, start = 0.0, time.process_time()
    for index, event in enumerate(events):
        if index == cut:
            pause = time.process_time()
            twin = copy.deepcopy(learner)
            twin.flush()
            head = twin.topology
            aside = time.process_time() - pause
        learner.receive(event)
        learner.updates()
    learner.flush()
    seconds = time.process_time() - start - aside
    assert learner.topology is not None
    assert head is not None
    return learner.topology, head, seconds


def network_figures(topology: Topology, truth: Truth, events: Sequence[Event]) -> dict[str, float]:
    """Return the figures of zones, links, relations and clocks, as far as the truth has them."""
    result = score(topology, with_camera_clocks(truth))
    figures: dict[str, float] = {"links_learned": result.links_learned}
    if truth.pairs:
        figures |= {
            "relation_right": relations_right(result, topology, truth),
            "pair_f1": harmonic_mean(result.pair_precision, result.pair_recall),
        }

    # Clock offsets.
    if any(truth.clock_offsets.values()):
        signed = clock_errors(topology, truth)
        errors = [abs(error) for error in signed.values()]
        stated_errors = {c.id: c.clock_offset_sd for c in topology.cameras if c.clock_offset_sd}
        if stated_errors:
            is_covered = [
                abs(signed[camera]) <= COVERED_SDS * sd for camera, sd in stated_errors.items()
            ]
            figures["clocks_covered"] = float(np.mean(is_covered))
        figures["clock_error"] = max(errors, default=math.nan)
        figures["clock_error_mean"] = float(np.mean(errors))
        figures["clocks_right"] = float(np.mean([error <= CLOCK_SECONDS_MAX for error in errors]))

    # Zones and false links.
    if truth.zones:
        figures |= {"zones_true": result.zones_true, "zones_learned": result.zones_learned}
        false = result.links_learned - result.links_right
        figures |= {"links_true": result.links_true, "false_links": false}
        figures["silent"] = float(false == 0)
        if all(zone.x is not None for zone in truth.zones):
            figures["zones_right"] = result.cameras_right / result.cameras

    # Links and transit times.
    if result.links_true:
        figures |= {
            "precision": result.link_precision,
            "recall": result.link_recall,
            "f1": harmonic_mean(result.link_precision, result.link_recall),
            "median_error": result.transit_error("q50"),
            "median_error_mean": result.transit_error("q50", np.mean),
            "transit_covered": covered_share(result, "q50"),
            "transit_mean_covered": covered_share(result, "mean"),
        }
        by_recording = score(topology, recorded_medians(events, truth))
        figures["recorded_median_error"] = by_recording.transit_error("q50")
    return figures


def harmonic_mean(a: float, b: float) -> float:
    """Return the harmonic mean of two shares, 0 if both are."""
    return 2 * a * b / (a + b) if a + b else 0.0


def relations_right(result: Score, topology: Topology, truth: Truth) -> float:
    """Return the share of pairs of cameras with their true relation.

    The pairs are those that were learned, or walked between with both ends recorded.
    """
    camera_of = {zone.id: zone.camera for zone in truth.zones}
    walked_pairs = {
        tuple(sorted((camera_of[link.from_], camera_of[link.to])))
        for link in truth.links
        if link.relation != "visible" and link.transitions > 0
    }
    expected = walked_pairs if truth.links else {pair.cameras for pair in truth.pairs}
    expected = expected | {pair.cameras for pair in topology.pairs}
    return result.pair_relations_right / len(expected) if expected else 1.0


def covered_share(result: Score, figure: str) -> float:
    """Return the share of right links whose true ``figure`` is within `COVERED_SDS` stated errors.

    It is nan without any.
    """
    is_covered = [
        abs(getattr(link.transit, figure) - getattr(true.transit, figure)) <= COVERED_SDS * sd
        for link, true in result.right
        if (sd := getattr(link.transit, f"{figure}_sd")) is not None
    ]
    return float(np.mean(is_covered)) if is_covered else math.nan


def with_camera_clocks(truth: Truth) -> Truth:
    """Return the truth with transit times by the clocks of the two cameras, as they are learned."""
    offset = {zone.id: truth.clock_offsets.get(zone.camera, 0.0) for zone in truth.zones}
    links = []
    for link in truth.links:
        late, was = offset[link.to] - offset[link.from_], link.transit
        shifted = {
            name: getattr(was, name) + late for name in ("mode", "mean", "q10", "q50", "q90")
        }
        links.append(msgspec.structs.replace(link, transit=msgspec.structs.replace(was, **shifted)))
    return msgspec.structs.replace(truth, links=links)


class Forecast(NamedTuple):
    """Predictions for the exits after the cut, their processor seconds, the version at the cut."""

    predictions: list[Prediction]
    seconds: float
    head: Topology


def predict(head: Topology, events: Sequence[Event]) -> Forecast:
    """Predict each exit after the cut with the version of the cut; all before it is observed."""
    cut = int(TRAIN_SHARE * len(events))
    predictor = Predictor(head)
    predictions: list[Prediction] = []
    start = time.process_time()
    for index in range(max(0, cut - WARM_EVENTS), len(events)):
        if index >= cut and events[index].kind == "exit":
            predictions.append(predictor.answer(events[index]))
        predictor.observe(events[index])
    return Forecast(predictions, time.process_time() - start, head)


def serve(events: Sequence[Event], settings: Settings) -> tuple[Topology, Forecast, float]:
    """Learn and predict as in service; return the last version, predictions, and seconds to learn.

    Each exit after the cut is predicted by the newest version published by then; versions are made
    only when they fall due.
    """
    cut = int(TRAIN_SHARE * len(events))
    learner, predictor, head = Learner(settings), None, None
    predictions: list[Prediction] = []
    observing = predicting = 0.0
    start = time.process_time()
    for index, event in enumerate(events):
        pause = time.process_time()
        if index == cut:
            head = learner.topology
        if predictor is not None:
            if index >= cut and event.kind == "exit":
                predictions.append(predictor.answer(event))
            predictor.observe(event)

        # Time of the predictor, which does not count as learning.
        if index < cut:
            observing += time.process_time() - pause
        else:
            predicting += time.process_time() - pause

        # Learn; follow new versions.
        learner.receive(event)
        for version in learner.updates():
            newer = Predictor(version)
            if predictor is not None:
                newer.take_over(predictor)
            predictor = newer
    seconds = time.process_time() - start - observing - predicting
    assert learner.topology is not None
    assert head is not None
    return learner.topology, Forecast(predictions, predicting, head), seconds


def prediction_figures(
    forecast: Forecast, events: Sequence[Event], truth: Truth
) -> dict[str, float]:
    """Score predictions after the cut, beside an oracle on the zones of the version at the cut.

    The oracle is a Markov chain that is given the identities up to the cut.
    """
    cut = int(TRAIN_SHARE * len(events))
    tail = msgspec.structs.replace(
        truth, identity=truth.identity[cut:], passage=truth.passage[cut:], zone=truth.zone[cut:]
    )
    predictions, seconds, head = forecast
    predictor = Predictor(head)
    place = predictor.zone_of
    states = [place(event) if event.kind == "exit" else None for event in events]

    def zone_of(event: Event) -> str | None:
        zone = place(event)
        return None if zone is None else predictor.zones[zone].id

    our_score = score_predictions(predictions, events[cut:], tail, zone_of=zone_of)
    chain = oracle_score(events, truth, cut, states)
    return {
        **_of_predictions(our_score, ""),
        **_of_predictions(chain, "told_"),
        "top1_ratio": our_score.top1 / chain.top1 if chain.top1 else math.nan,
        "top3_ratio": our_score.top3 / chain.top3 if chain.top3 else math.nan,
        "log_loss_above": our_score.log_loss - chain.log_loss,
        "first_calibration_error_all": our_score.first_calibration_error_all,
        "window_coverage": our_score.window_coverage,
        "prediction_ms": 1000 * seconds / max(len(predictions), 1),
    }


def baselines(regime: str, seed: int, events: Sequence[Event], truth: Truth) -> list[Record]:
    """Return the records of the baselines for zones and links, and of oracles for predictions.

    Links are of camera pairs where the truth has no zones.
    """
    # Oracles: next camera and transit times.
    cut = int(TRAIN_SHARE * len(events))
    cameras = [event.camera for event in events]
    chains: dict[str, Sequence[Hashable]] = {"most frequent next camera": cameras}
    if truth.zones:
        chains["Markov chain, true zones"] = truth.zone
    records = []
    for name, states in chains.items():
        start = time.process_time()
        result = oracle_score(events, truth, cut, states)
        seconds = time.process_time() - start
        records.append(
            Record(regime, seed, f"next: {name}", seconds, _plain(_of_predictions(result, "")))
        )
    if truth.zones:
        told_error = _plain({"median_error": transit_error(events, truth)})
        records.append(Record(regime, seed, "transit: told identities", 0.0, told_error))

    # Links and zones.
    if truth.zones or truth.pairs:
        records += links(regime, seed, events, truth)
    if truth.zones and all(zone.x is not None for zone in truth.zones):
        records += zones(regime, seed, events, truth)
    return records


def links(regime: str, seed: int, events: Sequence[Event], truth: Truth) -> list[Record]:
    """Return a record of every baseline for links, in both ranges of lags."""
    traffic = crossings(events, truth)
    candidate_sets = [candidates(traffic, lags=lags) for lags in (NARROW, WIDE)]
    records = []
    for name, method in LINK_METHODS.items():
        start = time.process_time()
        findings = by_range(method, traffic, candidate_sets)
        seconds = time.process_time() - start
        ranked = {variant: rank(result, traffic, truth) for variant, result in findings.items()}
        figures: dict[str, float | None] = {}
        if LITERAL in findings:
            printed = at(
                [rank(findings[LITERAL], traffic, truth, all_pairs=True)], LITERAL_SCORE_MIN
            )
            figures = {
                name: float(getattr(printed, name)[0]) for name in ("f1", "precision", "recall")
            }
        records.append(Record(regime, seed, f"links: {name}", seconds, figures, ranked))
    return records


def by_range(
    method: Callable[..., Any], traffic: Crossings, candidate_sets: Sequence[Candidates]
) -> dict[str, Findings]:
    """Return the findings of a method by variant, and by range of lags if it depends on that."""
    if method not in (*TAKE_CANDIDATES, *TAKE_LAGS):
        return dict(method(traffic))
    result: dict[str, Findings] = {}
    for candidate_set in candidate_sets:
        findings = method(
            traffic, candidate_set if method in TAKE_CANDIDATES else candidate_set.lags
        )
        result |= {
            f"{name}, {candidate_set.lags.low:g}..{candidate_set.lags.high:g} s": scores
            for name, scores in findings.items()
        }
    return result


def zones(regime: str, seed: int, events: Sequence[Event], truth: Truth) -> list[Record]:
    """Return a record of every clustering: by variant, the share of cameras with the true zones."""
    positions: dict[str, list[tuple[float, float]]] = {}
    for event in events:
        if event.x is not None and event.y is not None:
            positions.setdefault(event.camera, []).append((event.x, event.y))
    records = []
    for name, variants in methods().items():
        start = time.process_time()
        figures: dict[str, float | None] = {}
        for variant, cluster in variants.items():
            right = [
                _zones_right(cluster(np.array(at)), camera, truth)
                for camera, at in positions.items()
            ]
            figures[variant] = float(np.mean(right))
        records.append(Record(regime, seed, f"zones: {name}", time.process_time() - start, figures))
    return records


def _zones_right(centres: np.ndarray[Any, Any], camera: str, truth: Truth) -> bool:
    """Return True if a camera has exactly its true zones, within the tolerance."""
    true = [zone for zone in truth.zones if zone.camera == camera]
    learned_zones = [
        Zone(f"{camera}/{k}", camera, 1, 1, float(x), float(y)) for k, (x, y) in enumerate(centres)
    ]
    return len(true) == len(learned_zones) == len(match_zones(learned_zones, true))


def _of_predictions(result: PredictionScore, prefix: str) -> dict[str, float]:
    return {
        f"{prefix}exits": result.exits,
        f"{prefix}top1": result.top1,
        f"{prefix}top3": result.top3,
        f"{prefix}log_loss": result.log_loss,
        f"{prefix}calibration_error": result.calibration_error,
        f"{prefix}first_calibration_error": result.first_calibration_error,
        f"{prefix}first_calibration_floor": result.first_calibration_floor,
    }


def _plain(figures: dict[str, float]) -> dict[str, float | None]:
    """Replace nan by None, as JSON has no nan."""
    return {name: None if math.isnan(value) else float(value) for name, value in figures.items()}
