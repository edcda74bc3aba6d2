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
