"""Contexts in predictions: back-off, and the information they hold about the next camera."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given, strategies as st

from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.predict.contexts import ContextMultipliers
from camtopod.predict.hazards import Outcomes
from camtopod.records import (
    TOPOLOGY_SCHEMA,
    Camera,
    Context,
    Event,
    Model,
    Prediction,
    Topology,
    Zone,
)
from camtopod.topology.grid import BLOCKS_ACROSS, POSITION_ONE, block_of, blocks_of
from camtopod.topology.shared_constants import BACK_OFF_DEPARTURES, LEAVE_FLOOR, MULTIPLIER_MAX

NAMES = ["a/1", "a/2", "b/1", "c/1"]


def topology_with(contexts: list[Context] | None) -> Topology:
    zones = [Zone(name, name[0], 10, 10) for name in NAMES]
    cameras = [Camera(name, [zone.id for zone in zones if zone.camera == name]) for name in "abc"]
    model = Model(4.0, 0.1, -20.0, 120.0, [], [], contexts=contexts)
    return Topology(
        TOPOLOGY_SCHEMA, "hq", "01J", 1, 0.0, 80, "", cameras, zones, [], [], model=model
    )


def outcomes(share: list[float], leave: float) -> Outcomes:
    """Return the odds from a/1 to b/1 and c/1."""
    return Outcomes(
        [2, 3], np.array(share), leave, np.zeros((2, 1)), np.ones(1), np.zeros(2), np.zeros(2)
    )


SHARES = st.just(0.0) | st.floats(1e-4, 0.5)
COUNTS = st.tuples(*[st.just(0.0) | st.floats(1e-4, 50)] * 3)
SURE = st.just(0.0) | st.floats(1e-4, 1.2)
KEYS: list[tuple[str | None, int | None, str | None]] = [
    ("a/2", None, None),
    (None, 5, None),
    ("a/2", 5, None),
    (None, None, "c"),
]


@given(
    st.lists(st.none() | COUNTS, min_size=4, max_size=4),
    SHARES,
    SHARES,
    SHARES,
    st.booleans(),
    st.booleans(),
    SURE | st.none(),
)
def test_multipliers_equal_their_slow_twin(
    counts: list[tuple[float, float, float] | None],
    b: float,
    c: float,
    leave: float,
    entered: bool,
    placed: bool,
    sure: float | None,
) -> None:
    rows, steps = [], []
    told = [entered, placed, entered and placed, sure is not None]
    for key, count, asked in zip(KEYS, counts, told, strict=True):
        n, to_b, to_c = count or (0.0, 0.0, 0.0)
        if count is not None:
            entry, block, previous = key
            rows.append(Context("a/1", n, {"b/1": to_b, "c/1": to_c}, entry, block, previous))
        if asked:
            steps.append(
                (n, {2: to_b, 3: to_c}, min(sure, 1.0) if key[2] and sure is not None else 1.0)
            )
    surroundings = ContextMultipliers(topology_with(rows))
    fast, leaving = surroundings.multipliers(
        0,
        outcomes([b, c], leave),
        5 if placed else None,
        1 if entered else None,
        "c" if sure is not None else None,
        sure or 0.0,
    )
    if not rows:
        assert (fast.tolist(), leaving) == ([1.0, 1.0], leave)
        return
    slow, stays = naive.surroundings(
        {2: b, 3: c}, leave, steps, BACK_OFF_DEPARTURES, MULTIPLIER_MAX, LEAVE_FLOOR
    )
    assert fast == pytest.approx([slow[2], slow[3]])
    assert leaving == pytest.approx(stays)


@pytest.mark.parametrize("contexts", [None, [], [Context("b/1", 30.0, {"c/1": 30.0}, block=5)]])
def test_a_zone_without_contexts_knows_nothing_more(contexts: list[Context] | None) -> None:
    likelier, leave = ContextMultipliers(topology_with(contexts)).multipliers(
        0, outcomes([0.4, 0.4], 0.2), 5, 1, "c", 1.0
    )
    assert likelier.tolist() == [1.0, 1.0]
    assert leave == 0.2


def test_without_a_model_too() -> None:
    plain = Topology(TOPOLOGY_SCHEMA, "hq", "01J", 1, 0.0, 0, "", [], [], [], [])
    likelier, _ = ContextMultipliers(plain).multipliers(
        0, outcomes([0.4, 0.4], 0.2), 5, 1, "c", 1.0
    )
    assert likelier.tolist() == [1.0, 1.0]


def test_a_context_never_seen_says_nothing_and_a_rare_one_little() -> None:
    rows = [
        Context("a/1", 0.5, {"b/1": 0.5}, block=7),
        Context("a/1", 500.0, {"b/1": 500.0}, block=8),
    ]
    known = ContextMultipliers(topology_with(rows))
    never, rare, often = (
        known.multipliers(0, outcomes([0.4, 0.4], 0.2), block, None, None, 0.0)[0][0]
        for block in (6, 7, 8)
    )
    assert never == 1.0
    assert rare == pytest.approx(1.0, abs=0.2)
    assert often == pytest.approx(1 / 0.4, rel=0.02)


@given(st.floats(0, 1), st.floats(0, 1))
def test_the_block_of_one_position_is_that_of_the_window(x: float, y: float) -> None:
    px, py = (np.array([round(p * POSITION_ONE)], np.int32) for p in (x, y))
    (block,) = blocks_of(px, py).tolist()
    assert block == block_of(x, y)
    assert 0 <= block < BLOCKS_ACROSS**2


def test_no_position_no_block() -> None:
    assert block_of(None, None) is None
    assert blocks_of(np.array([-1], np.int32), np.array([-1], np.int32)).tolist() == [-1]


# --- what learning and prediction make of it ---


def road(seed: int, vehicles: int) -> list[Event]:
    """Return five cameras in a row without positions; half of the vehicles go each way."""
    rng = np.random.default_rng(seed)
    events = []
    for k, t in enumerate(rng.uniform(0, 60.0 * vehicles, vehicles)):
        for camera in "abcde" if k % 2 else "edcba":
            stay = rng.uniform(2, 4)
            events.append(Event(camera, "entry", t, track=str(k)))
            events.append(Event(camera, "exit", t + stay, track=str(k)))
            t += stay + rng.uniform(8, 14)
    return sorted(events, key=lambda event: event.t)


def asked(events: list[Event], cut: int) -> list[tuple[Event, Prediction]]:
    """Learn the first ``cut`` events and predict the exits after them."""
    learner = Learner(Settings(version_seconds=1e6))
    for event in events[:cut]:
        learner.receive(event)
    learner.flush()
    predictor, answers = learner.predictor(), []
    for k, event in enumerate(events):
        if event.kind == "exit" and k >= cut:
            answers.append((event, predictor.predict(event)))
        predictor.observe(event)
    return answers


def right(answers: list[tuple[Event, Prediction]], goes_to: dict[tuple[str, str], str]) -> float:
    """Return the top-1 of the predictions for objects that go on (by camera and track)."""
    known = [
        (p, goes_to[e.camera, str(e.track)])
        for e, p in answers
        if (e.camera, str(e.track)) in goes_to
    ]
    return float(np.mean([bool(p.next_) and p.next_[0].camera == camera for p, camera in known]))


def test_on_a_road_the_camera_before_says_which_way() -> None:
    """From the present camera alone, one prediction in two is right."""
    events = road(0, 300)
    goes_to = {
        (camera, str(k)): following
        for k in range(300)
        for camera, following in (
            zip("bcd", "cde", strict=True) if k % 2 else zip("dcb", "cba", strict=True)
        )
    }
    answers = asked(events, 2 * len(events) // 3)
    assert right(answers, goes_to) > 0.93
    forgetful = [Event(e.camera, e.kind, e.t) for e in events]  # no tracks: no direction
    by_time = {
        (e.camera, str(e.t)): goes_to[e.camera, str(e.track)]
        for e in events
        if (e.camera, str(e.track)) in goes_to
    }
    blind = [
        (Event(e.camera, e.kind, e.t, track=str(e.t)), p)
        for e, p in asked(forgetful, 2 * len(events) // 3)
    ]
    assert 0.3 < right(blind, by_time) < 0.7


@pytest.mark.parametrize("known", ["entry", "block"])
def test_in_a_hall_where_they_came_in_or_left_says_where_they_go(known: str) -> None:
    """Hall a has one exit. Objects that enter on the left, or leave at its upper end, go to b."""
    rng = np.random.default_rng(1)
    events, goes_to = [], {}
    for k, t in enumerate(rng.uniform(0, 12_000, 400)):
        left = rng.random() < 0.5
        x, y = rng.normal(0.5, 0.02), rng.normal(0.5, 0.02)
        if known == "entry":
            x, way_out = (0.1 if left else 0.9) + rng.normal(0, 0.02), 0.5 + rng.normal(0, 0.02)
        else:
            way_out = float(rng.uniform(0.35, 0.48) if left else rng.uniform(0.52, 0.65))
            y = 0.1
        events.append(
            Event(
                "a",
                "entry",
                t,
                float(np.clip(x, 0, 1)),
                float(y) if known == "block" else 0.9,
                str(k),
            )
        )
        events.append(Event("a", "exit", t + 5, 0.5 + float(rng.normal(0, 0.02)), way_out, str(k)))
        goes_to["a", str(k)] = camera = "b" if left else "c"
        events.append(Event(camera, "entry", t + 15 + float(rng.normal(0, 1)), 0.5, 0.5, str(k)))
        events.append(Event(camera, "exit", t + 22, 0.5, 0.5, str(k)))
    events.sort(key=lambda event: event.t)
    answers = asked(events, 2 * len(events) // 3)
    assert right(answers, goes_to) > 0.95
