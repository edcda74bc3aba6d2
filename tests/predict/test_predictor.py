"""Predictions: competing outcomes that sum to 1, from what is known at the exit."""

from __future__ import annotations

import math
import random
from collections import Counter
from functools import cache

import naive
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from model_rows import (
    CameraModel,
    Context,
    EntryKernel,
    LabelModel,
    Model,
    Onward,
    Outcome,
    Pace,
    Way,
    ZoneModel,
    rows_of,
    with_rows,
)
from msgspec.structs import astuple, replace

from bench.support.prediction_scores import score_predictions
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.predict import anywhere, passages, recent_events
from camtopod.predict.outlook import NEXT_PROBABILITY_MIN, RATE_MIN
from camtopod.predict.predictor import Predictor
from camtopod.predict.predictor_memory import DEAD_PRIOR
from camtopod.records import (
    TOPOLOGY_SCHEMA,
    Camera,
    Event,
    Histogram,
    Link,
    Prediction,
    Topology,
    Transit,
    Zone,
)
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.sim.truth import Truth
from camtopod.topology import UnknownPlace
from camtopod.topology.lag_bins import LagBins
from camtopod.topology.shared_constants import (
    BACK_OFF_DEPARTURES,
    DWELL_SECONDS_MIN,
    LEAVE_FLOOR,
    MULTIPLIER_MAX,
    SLOWNESS_MAX,
)

COV = [[0.001, 0.0], [0.0, 0.001]]
STAY = [float(k) for k in range(11)]
"""Deciles of passages of 0 to 10 s."""


@pytest.fixture(autouse=True)
def _everything_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let nothing be anywhere; that is tested in test_anywhere."""
    monkeypatch.setattr(anywhere, "surplus", lambda departures, leave, cameras: 0.0)


def link(
    from_: str, to: str, probability: float, median: float, histogram: Histogram | None = None
) -> Link:
    transit = Transit(median, median, 1.0, median - 1.0, median, median + 1.0)
    relation = "overlapped" if median < 0 else "unseen"
    return Link(from_, to, relation, probability, 100 * probability, transit, 0.0, 0.1, histogram)


def a_topology(
    links: list[Link], weak: list[Link] | None = None, stay: list[float] | None = None
) -> Topology:
    """Return cameras a (two zones), b, c, d, each with a quarter of the events."""
    zones = [
        Zone("a/1", "a", 100, 100, 0.1, 0.5, COV),
        Zone("a/2", "a", 100, 100, 0.9, 0.5, COV),
        *(Zone(f"{name}/1", name, 100, 100, 0.5, 0.5, COV) for name in "bcd"),
    ]
    model = Model(
        4.0,
        0.1,
        -20.0,
        120.0,
        [ZoneModel(zone.id, 100, 0.001, STAY if stay is None else stay) for zone in zones],
        [CameraModel(name, 0.25, 0.0) for name in "abcd"],
    )
    cameras = [Camera(name, [zone.id for zone in zones if zone.camera == name]) for name in "abcd"]
    plain = Topology(TOPOLOGY_SCHEMA, "hq", "01J", 7, 0.0, 800, "", cameras, zones, links, [])
    return with_rows(plain, model, weak or [])


THREE = a_topology(
    [link("a/1", "b/1", 0.5, 8.0), link("a/1", "c/1", 0.3, 20.0)], [link("a/1", "a/2", 0.1, 30.0)]
)
EXIT = Event("a", "exit", 1000.0, 0.1, 0.5, "17")


def chances(prediction: Prediction) -> dict[str, float]:
    found: Counter[str] = Counter()
    for one in prediction.next:
        found[one.zone] += one.probability
    return dict(found)


def sound(prediction: Prediction) -> None:
    """Check the invariants of every prediction."""
    probabilities = [found.probability for found in prediction.next]
    assert prediction.leave + sum(probabilities) == pytest.approx(1.0)
    assert 0 < prediction.leave <= 1
    assert probabilities == sorted(probabilities, reverse=True)
    assert all(p > 0 for p in probabilities)
    assert all(-133 <= n.q10 <= n.q50 <= n.q90 <= 200 * math.exp(1.5) for n in prediction.next)
    assert len({(one.zone, one.q50) for one in prediction.next}) == len(probabilities)


# --- the learned shares ---


def test_without_further_knowledge_the_learned_shares() -> None:
    prediction = Predictor(THREE).predict(EXIT)
    sound(prediction)

    assert (prediction.camera, prediction.zone, prediction.t, prediction.track) == (
        "a",
        "a/1",
        1000.0,
        "17",
    )
    assert prediction.version == 7
    assert [(found.camera, found.zone) for found in prediction.next] == [
        ("b", "b/1"),
        ("c", "c/1"),
        ("a", "a/2"),
    ]
    assert chances(prediction) == pytest.approx({"b/1": 0.5, "c/1": 0.3, "a/2": 0.1}, abs=0.001)
    assert prediction.leave == pytest.approx(0.1, abs=0.001)
    for found, median in zip(prediction.next, (8.0, 20.0, 30.0), strict=True):
        assert found.q50 == pytest.approx(median, rel=0.1)
        assert found.q10 < median - 0.5
        assert found.q90 > median + 0.5


def test_a_camera_without_a_zone_or_without_links_leads_nowhere() -> None:
    for event, zone in (
        (replace(EXIT, x=0.8), "a/2"),
        (replace(EXIT, camera="b"), "b/1"),
    ):
        prediction = Predictor(THREE).predict(event)
        assert (prediction.zone, prediction.leave, prediction.next) == (zone, 1.0, [])


def test_of_a_listed_camera_without_a_zone_nothing_is_known_and_another_is_unknown() -> None:
    new = replace(EXIT, camera="new")
    predictor = Predictor(replace(THREE, model=None, cameras=[*THREE.cameras, Camera("new", [])]))
    assert predictor.predict(new) == predictor.answer(new)
    assert str(predictor.predict(new)) == "not known yet"

    predictor = Predictor(THREE)
    predictor.observe(new)
    with pytest.raises(UnknownPlace, match="no camera 'new'; there are"):
        predictor.predict(new)
    assert str(predictor.answer(new)) == "not known yet"


def test_a_topology_that_has_only_what_the_contract_asks() -> None:
    plain = replace(THREE, model=None)
    prediction = Predictor(plain).predict(EXIT)
    sound(prediction)

    assert list(chances(prediction)) == ["b/1", "c/1"]
    assert prediction.next[0].q50 == pytest.approx(8.0, abs=0.5)
    empty = replace(plain, links=[])
    assert Predictor(empty).predict(EXIT).next == []


# --- exposure, seen, alive ---

OVERLAP = a_topology([link("a/1", "d/1", 0.4, -3.0), link("a/1", "b/1", 0.3, 8.0)])


def predictor_after(events: list[Event], topology: Topology = OVERLAP) -> Predictor:
    predictor = Predictor(topology)
    for event in events:
        predictor.observe(event)
    return predictor


def after(events: list[Event], topology: Topology = OVERLAP) -> Prediction:
    predictor = predictor_after(events, topology)
    prediction = predictor.predict(EXIT)
    sound(prediction)
    return prediction


ENTERED = Event("a", "entry", 990.0, 0.5, 0.1, "17")
THERE = Event("d", "entry", 997.0, 0.5, 0.5, "3")


@pytest.mark.parametrize("exit_", [EXIT, replace(EXIT, track=None)])
def test_an_exit_that_was_observed_does_not_compete_with_itself(exit_: Event) -> None:
    events = [Event("d", "entry", 950.0, 0.5, 0.5), ENTERED, THERE]
    before = chances(predictor_after(events).predict(exit_))
    afterwards = chances(predictor_after([*events, exit_]).predict(exit_))
    assert afterwards == pytest.approx(before, rel=1e-2)  # another event that others lack


def test_who_has_been_seen_in_the_overlapping_view_is_there() -> None:
    there = after([ENTERED, THERE])
    assert chances(there)["d/1"] > 0.9
    assert there.leave < 0.1 < after([ENTERED]).leave


def test_who_has_not_been_seen_there_is_not() -> None:
    """The share of the overlapped view, 0.4, is gone; the ratios of the others stay."""
    prediction = after([ENTERED])

    assert chances(prediction).get("d/1", 0.0) < 0.01
    assert chances(prediction)["b/1"] == pytest.approx(0.3 / 0.6, abs=0.01)
    assert prediction.leave == pytest.approx(0.3 / 0.6, abs=0.01)
    for other in (
        replace(THERE, t=970.0),  # too early
        replace(THERE, t=1000.0),  # not before the exit
        replace(THERE, camera="c"),
        replace(THERE, kind="exit"),
    ):
        assert chances(after([ENTERED, other])).get("d/1", 0.0) < 0.01


def test_others_who_may_be_the_one_seen_lower_the_chance() -> None:
    """Another object that leaves at the same time, or is in the view, may be the one seen at d."""
    alone = chances(after([ENTERED, THERE]))["d/1"]
    two = chances(
        after([ENTERED, replace(ENTERED, track="18"), THERE, replace(EXIT, t=999.9, track="18")])
    )["d/1"]
    inside = chances(after([ENTERED, replace(ENTERED, track="18"), THERE]))["d/1"]
    crowd = [replace(ENTERED, track=str(k)) for k in range(100, 160)]
    crowded = chances(after([ENTERED, *crowd, THERE]))["d/1"]

    assert two < alone
    assert crowded < inside < alone
    unrelated = [replace(ENTERED, camera="b", x=0.5, y=0.5, track=str(k)) for k in range(5)]
    assert chances(after([ENTERED, *unrelated, THERE]))["d/1"] == pytest.approx(alone, rel=1e-3)


def test_a_silent_camera_is_not_where_they_appear() -> None:
    talk = [Event(camera, "entry", 900.0 + k, 0.5, 0.5) for k in range(30) for camera in "abd"]
    silent = after(talk, THREE)

    assert chances(silent)["b/1"] == pytest.approx(
        chances(Predictor(THREE).predict(EXIT))["b/1"], rel=0.5
    )
    assert chances(silent).get("c/1", 0.0) < 1e-3
    heard = after([*talk, Event("c", "exit", 950.0)], THREE)
    assert chances(heard)["c/1"] == pytest.approx(0.3, abs=0.01)
    strangers = [Event("unknown", "entry", 900.0 + k) for k in range(3)]
    assert chances(after(strangers, THREE))["c/1"] == pytest.approx(0.3, abs=0.01)


# --- bounds, versions ---


def test_what_is_remembered_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also with passages that never end."""
    monkeypatch.setattr(recent_events, "RECENT_MAX", 7)
    monkeypatch.setattr(passages, "OPEN_MAX", 7)
    predictor = Predictor(THREE)
    for k in range(50):
        predictor.observe(replace(ENTERED, t=float(k), track=str(k)))
        predictor.observe(replace(EXIT, t=float(k), track=None))
        predictor.observe(replace(EXIT, t=float(k), track=f"only {k}"))
    state = predictor.save()

    assert len(state.under_way) == len(state.arrivals.t) == len(state.exits.t) == 7
    assert len(predictor._memory.passages._ended_passages) == 7


def test_what_is_remembered_is_in_order_of_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the order in which it comes."""
    monkeypatch.setattr(recent_events, "RECENT_MAX", 7)
    for seed in range(20):
        chance = random.Random(seed)
        times = [float(chance.randrange(40)) for _ in range(30)]
        events = recent_events.RecentEvents()
        for number, t in enumerate(times):
            events.append(t, number, -number, entry_t=t / 3, entry=number + 1)
        columns = events.save()
        rows = list(zip(*astuple(columns), strict=True))

        newest = sorted(enumerate(times), key=lambda one: one[1])[-7:]
        assert rows == [(t, number, -number, t / 3, number + 1) for number, t in newest]
        since = chance.choice(times)
        assert events.after(since).t.tolist() == [t for _, t in newest if t >= since]


def test_a_newer_version_remembers_what_has_been_seen() -> None:
    predictor = Predictor(OVERLAP)
    events = [
        ENTERED,
        THERE,
        replace(EXIT, t=999.0, track="9"),
        *(Event("b", "entry", 995.0, 0.5, 0.5) for _ in "xy"),
    ]
    for event in events:
        predictor.observe(event)
    rows = rows_of(OVERLAP)
    reordered = with_rows(replace(OVERLAP, version=8, zones=OVERLAP.zones[::-1]), rows)
    followed = Predictor(reordered)
    followed.take_over(predictor)

    assert replace(followed.predict(EXIT), version=7) == predictor.predict(EXIT)
    gone = replace(OVERLAP, version=8, zones=[z for z in OVERLAP.zones if z.camera != "d"])
    gone = with_rows(gone, rows, [], zones=[z for z in rows.zones if z.zone != "d/1"])
    followed = Predictor(gone)
    followed.take_over(predictor)
    prediction = followed.predict(EXIT)
    sound(prediction)
    assert list(chances(prediction)) == ["b/1"]


# --- the whole of it, against its slow twin ---

CONSTANTS = (
    BACK_OFF_DEPARTURES,
    MULTIPLIER_MAX,
    LEAVE_FLOOR,
    DEAD_PRIOR,
    NEXT_PROBABILITY_MIN,
    RATE_MIN,
    DWELL_SECONDS_MIN,
    SLOWNESS_MAX,
)
SMALL = LagBins(-20.0, 60.0)


def any_pace(rng: np.random.Generator, names: list[str]) -> Pace | None:
    """Draw a speed model: persistence, and usual dwell times of some zones."""
    ways = [
        Way(a, b, float(rng.uniform(1, 30)))
        for a in names
        for b in names
        if a[0] == b[0] and rng.random() < 0.7
    ]
    return Pace(1.0, float(rng.random()), 0.3, ways) if rng.random() < 0.7 else None


def any_label(rng: np.random.Generator) -> str | None:
    return [None, "bus", "car", "cat"][int(rng.integers(4))]


def any_topology(rng: np.random.Generator) -> Topology:
    """Draw four zones with any links, entry kernels, dwell times and contexts."""

    def histogram(low: int, high: int, mass: float) -> Histogram:
        first = int(rng.integers(low, high - 3))
        return Histogram(
            first, (mass * rng.dirichlet(np.ones(int(rng.integers(1, high - first))))).tolist()
        )

    names = ["a/1", "a/2", "b/1", "c/1"]
    zones = [
        Zone(n, n[0], 50, int(rng.integers(1, 90)), 0.2 if n != "a/2" else 0.8, 0.5, COV)
        for n in names
    ]
    onward, entered, contexts = [], [], []
    for name in names:
        targets = [n for n in names if rng.random() < 0.7]
        share = rng.dirichlet(np.ones(len(targets) + 1))
        if targets:
            following = [
                Outcome(n, s, histogram(-24, 34, s), float(rng.random()))
                for n, s in zip(targets, share.tolist(), strict=False)
            ]
            onward.append(Onward(name, max(float(share[-1]), 0.02), following))
        else:
            onward.append(Onward(name, 1.0, []))
        entered += [
            EntryKernel(name, n, histogram(0, 34, 0.5))
            for n in names
            if n[0] != name[0] and rng.random() < 0.5
        ]
        for entry, block, previous in (
            ("a/2", 19, None),
            (None, None, "b"),
        ):
            if rng.random() < 0.5:
                counts = {n: float(rng.uniform(0, 9)) for n in targets}
                contexts.append(
                    Context(name, sum(counts.values()) * 1.2, counts, entry, block, previous)
                )
    stay = [
        [0.0, *np.sort(rng.uniform(0, 30, 9)).tolist(), 100.0] if rng.random() < 0.7 else []
        for _ in names
    ]
    model = Model(
        SMALL.scale,
        SMALL.step,
        SMALL.lag_min,
        SMALL.lag_max,
        [
            ZoneModel(n, 50, float(rng.uniform(0, 0.05)), s)
            for n, s in zip(names, stay, strict=True)
        ],
        [CameraModel(c, float(rng.uniform(0.1, 0.5)), 0.0) for c in "abc"],
        onward=onward,
        entered=entered,
        contexts=contexts,
        pace=any_pace(rng, names),
    )
    if rng.random() < 0.7:
        shares = {n: rng.dirichlet(np.ones(2)).tolist() for n in names}
        labels = LabelModel(["bus", "car"], float(rng.uniform(0, 0.99)), shares)
        model = replace(model, labels=labels)
    cameras = [Camera(c, [n for n in names if n[0] == c]) for c in "abc"]
    plain = Topology(TOPOLOGY_SCHEMA, "hq", "01J", 1, 0.0, 800, "", cameras, zones, [], [])
    return with_rows(plain, model, [])


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_odds_asked_for_later_equal_their_slow_twin(seed: int) -> None:
    """Whether the exit has been observed or not, and for any later events."""
    rng = np.random.default_rng(seed)
    topology = any_topology(rng)
    exit_ = Event(
        str(rng.choice(list("abc"))), "exit", 20.0, 0.2, 0.55, "its" if rng.random() < 0.8 else None
    )
    exit_ = replace(exit_, label=any_label(rng))
    seen = [
        Event(
            str(rng.choice(list("abc"))),
            "exit" if rng.random() < 0.4 else "entry",
            float(t),
            float(rng.choice([0.2, 0.8])),
            0.55,
            str(rng.integers(0, 4)) if rng.random() < 0.8 else None,
            label=any_label(rng),
        )
        for t in rng.uniform(0, 45, int(rng.integers(0, 30)))
    ]
    if exit_.track is not None and rng.random() < 0.8:
        seen.append(
            replace(
                exit_, kind="entry", t=float(rng.uniform(0, 20)), x=float(rng.choice([0.2, 0.8]))
            )
        )
    now = float(
        rng.choice([20.0, rng.uniform(20, 23), rng.uniform(20, 60), seen[0].t if seen else 20.0])
    )
    now = max(now, 20.0)
    for events in (seen, [*seen, exit_]):
        ordered = sorted(events, key=lambda event: event.t)
        predictor = Predictor(topology)
        for event in ordered:
            predictor.observe(event)
        fast = predictor.predict(exit_, now)
        slow = naive.predicted(topology, ordered, exit_, predictor.zone_of, CONSTANTS, now)
        assert fast.leave == pytest.approx(slow.pop(None), rel=1e-6)
        assert chances(fast) == pytest.approx(
            {topology.zones[v].id: p for v, p in slow.items()}, rel=1e-6
        )
        sound(fast)


@cache
def a_made_up_network() -> tuple[list[Event], Truth, int, Learner]:
    """Return events, truth, the number of events learned, and the learner after one fit."""
    events, truth = simulate(SimSettings(cameras=6, hours=0.7, seed=2))
    cut = 3 * len(events) // 4
    learner = Learner(Settings(refit_share=1e9, refit_hours=1e9))
    for event in events[:cut]:
        learner.receive(event)
    learner.flush()
    return events, truth, cut, learner


def uncounted(event: Event) -> Prediction:
    """Return a prediction that does not count."""
    return Prediction(event.camera, None, event.t, None, 1, 1.0, [])


def test_predictions_on_a_made_up_network() -> None:
    """Learned from the first three quarters; a random guess is right for one camera in six."""
    events, truth, cut, learner = a_made_up_network()
    predictor, predictions = learner.predictor(), []
    for k, event in enumerate(events):
        if event.kind == "exit" and k < cut:
            predictions.append(uncounted(event))
        elif event.kind == "exit":
            predictions.append(predictor.predict(event))
            sound(predictions[-1])
        predictor.observe(event)
    scored = score_predictions(predictions, events, truth, since=events[cut].t)
    blind = [
        replace(
            p,
            leave=0.2,
            next=[replace(n, probability=0.8 / max(len(p.next), 1)) for n in p.next],
        )
        for p in predictions
    ]

    assert scored.top1 > 0.6
    assert scored.top3 > 0.85
    assert (
        scored.log_loss
        < score_predictions(blind, events, truth, since=events[cut].t).log_loss - 0.3
    )
    assert math.isfinite(scored.log_loss)


def test_an_arrival_of_another_label_is_hardly_the_one() -> None:
    """So the object is still to come; the label of an exit is that of its entry."""
    shares = {zone.id: [0.1, 0.9] for zone in OVERLAP.zones}
    labels = LabelModel(["bus", "car"], 0.9999, shares)
    topology = with_rows(OVERLAP, labels=labels)

    def there(mine: str | None, seen: str | None, exit_: str | None = None) -> float:
        predictor = Predictor(topology)
        predictor.observe(replace(ENTERED, label=mine))
        predictor.observe(replace(THERE, label=seen))
        return chances(predictor.predict(replace(EXIT, label=exit_))).get("d/1", 0.0)

    unknown = there(None, None)
    assert there("bus", "bus") > unknown
    assert there("bus", "car") < 0.5 * unknown
    assert there("bus", "cat") == there("cat", "bus") == unknown
    assert there(None, "bus", exit_="bus") == pytest.approx(there("bus", "bus"), rel=0.1)


def test_a_newer_version_numbers_labels_anew() -> None:
    shares = {zone.id: [0.1, 0.9] for zone in OVERLAP.zones}
    older, newer = (
        with_rows(OVERLAP, labels=LabelModel(names, 0.9, shares))
        for names in (["bus", "car"], ["car", "truck"])
    )
    predictor = Predictor(older)
    for track, label in enumerate(["bus", "car", None]):
        predictor.observe(replace(ENTERED, label=label, track=str(track)))
        predictor.observe(replace(EXIT, label=label, track=None))
    followed = Predictor(newer)
    followed.take_over(predictor)

    state = followed.save()
    assert state.arrivals.label.tolist() == [-1, 0, -1]
    assert state.exits.label.tolist() == [-1, 0, -1]
    assert [passage.label for _, _, passage in state.under_way] == [-1, 0, -1]
