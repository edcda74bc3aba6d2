"""Events that are heard out of order of time count as in order of time."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from model_rows import rows_of, with_rows
from msgspec.structs import replace
from serving import T0
from test_predictor import ENTERED, EXIT, OVERLAP, THERE, any_label, any_topology, chances

from camtopod.predict import Predictor, Walks
from camtopod.predict.walk_memory import REVISE_SECONDS
from camtopod.records import Event, Topology

SPAN = 45.0
"""Seconds in which objects come."""
CLOSING = [Event(camera, "exit", SPAN + 30.0) for camera in "abc"]
"""After all else, so that the cameras have reported last in the same order."""


def passing(rng: np.random.Generator) -> list[Event]:
    """Return entry and exit of objects that pass any view, in order of time; some stay."""
    events = []
    for track in range(15):
        camera, t, label = str(rng.choice(list("abc"))), rng.uniform(0.0, SPAN), any_label(rng)
        x = float(rng.choice([0.2, 0.8]))
        events.append(Event(camera, "entry", t, x, 0.55, str(track), label=label))
        if rng.random() < 0.8:
            t, x = t + rng.uniform(1.0, 20.0), float(rng.choice([0.2, 0.8]))
            events.append(Event(camera, "exit", t, x, 0.55, str(track)))
    return sorted(events, key=lambda event: event.t)


def shuffled(rng: np.random.Generator, events: list[Event]) -> list[Event]:
    """Return the events as they are heard up to a second late."""
    heard_at = [event.t + rng.random() for event in events]
    return [events[k] for k in np.argsort(heard_at)]


def with_late_entries(rng: np.random.Generator, events: list[Event]) -> list[Event]:
    """Return the events so that entries are heard up to 8 s late, but before their exits."""
    exit_t = {(event.camera, event.track): event.t for event in events if event.kind == "exit"}
    heard_at = [
        min(event.t + 8.0 * rng.random(), exit_t.get((event.camera, event.track), np.inf) - 1e-3)
        if event.kind == "entry"
        else event.t
        for event in events
    ]
    return [events[k] for k in np.argsort(heard_at)]


def swapped(rng: np.random.Generator, events: list[Event]) -> list[Event]:
    """Return the events so that half of the entries are heard just after their exits."""
    exit_t = {(event.camera, event.track): event.t for event in events if event.kind == "exit"}
    heard_at = [
        max(event.t, exit_t.get((event.camera, event.track), 0.0) + 1e-3)
        if event.kind == "entry" and rng.random() < 0.5
        else event.t
        for event in events
    ]
    return [events[k] for k in np.argsort(heard_at)]


def observed(topology: Topology, events: list[Event]) -> Predictor:
    predictor = Predictor(topology)
    for event in (*events, *CLOSING):
        predictor.observe(event)
    return predictor


def remembered(predictor: Predictor) -> tuple[object, object, object]:
    """Return the passages that are open, those that ended, and the newest exits by camera."""
    passages = predictor._memory.passages
    opened = {key: (passage.t, passage.label) for key, passage in passages.open.passages()}
    ended = {
        key: (t, passage and (passage.t, passage.entry, passage.label))
        for key, (t, passage) in passages._ended_passages.items()
    }
    newest = {
        camera: (t, sorted(track for track, _ in exits))
        for camera, (t, exits) in passages._last_exits.items()
    }
    return opened, ended, newest


def plain_topology(rng: np.random.Generator) -> Topology:
    """Draw a version in which objects appear in other views only.

    Clocks are up to 5 s off.
    """
    topology = any_topology(rng)
    cameras = [
        replace(camera, clock_offset=float(rng.uniform(-5.0, 5.0))) for camera in topology.cameras
    ]
    topology = replace(topology, cameras=cameras)
    onward = [
        replace(row, next_=[to for to in row.next_ if to.to[0] != row.zone[0]])
        for row in rows_of(topology).onward
    ]
    return with_rows(topology, onward=onward)


def heard(
    seed: int,
    topology_of: Callable[[np.random.Generator], Topology],
    order: Callable[[np.random.Generator, list[Event]], list[Event]],
) -> tuple[list[Event], Predictor, Predictor]:
    """Return events, and predictors that heard them in order of time and in another order."""
    rng = np.random.default_rng(seed)
    topology, events = topology_of(rng), passing(rng)
    return events, observed(topology, events), observed(topology, order(rng, events))


@settings(max_examples=30)
@given(st.integers(0, 10**6))
@example(40367)  # an arrival is heard after an exit whose passage began after it
@pytest.mark.parametrize("order", [shuffled, with_late_entries, swapped])
def test_predictions_are_those_in_order_of_time(
    order: Callable[[np.random.Generator, list[Event]], list[Event]], seed: int
) -> None:
    events, in_order, late = heard(seed, plain_topology, order)

    assert remembered(late) == remembered(in_order)
    for event in events:
        if event.kind == "exit":
            for now in (None, event.t + 4.0):
                expected, answer = in_order.predict(event, now), late.predict(event, now)
                assert answer.leave == pytest.approx(expected.leave, rel=1e-6)
                assert chances(answer) == pytest.approx(chances(expected), rel=1e-6)


@pytest.mark.parametrize("order", [shuffled, with_late_entries, swapped])
def test_a_state_after_late_events_has_plain_numbers(
    order: Callable[[np.random.Generator, list[Event]], list[Event]],
) -> None:
    """Others than plain ones cannot be stored in a snapshot of the learner."""
    for seed in range(20):
        _, _, late = heard(seed, any_topology, order)
        msgspec.msgpack.encode(late.save().under_way)


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_a_passage_whose_exit_is_heard_first_is_over(seed: int) -> None:
    _, in_order, late = heard(seed, any_topology, swapped)
    assert remembered(late) == remembered(in_order)


def test_an_entry_of_long_ago_without_an_exit_causes_nothing_now() -> None:
    predictions = []
    for old_entries in ([], [replace(ENTERED, t=ENTERED.t - 7200.0, track="old")]):
        predictor = Predictor(OVERLAP)
        for event in (ENTERED, THERE, *old_entries):
            predictor.observe(event)
        predictions.append(chances(predictor.predict(EXIT)))
    without, with_it = predictions
    assert with_it == pytest.approx(without, rel=1e-3)  # silent cameras miss one more event


def test_an_entry_that_comes_again_after_its_exit_causes_nothing() -> None:
    predictor = Predictor(OVERLAP)
    for event in (ENTERED, THERE, EXIT):
        predictor.observe(event)
    other_exit = replace(EXIT, track="other")
    probabilities = chances(predictor.predict(other_exit))
    predictor.observe(replace(ENTERED, t=ENTERED.t - 0.25))
    assert chances(predictor.predict(other_exit)) == pytest.approx(probabilities, rel=1e-2)


def test_an_older_exit_does_not_replace_the_newest_of_a_camera() -> None:
    """Of a moment, the passages that end at it may be in view; an older exit is heard later."""
    predictor = Predictor(OVERLAP)
    for event in (ENTERED, THERE, EXIT, Event("a", "exit", EXIT.t - 1.0, 0.1, 0.5, "9")):
        predictor.observe(event)
    assert predictor._memory.passages.open_at("a", EXIT.t, EXIT.t)


Walked = tuple[set[tuple[str, str]], dict[tuple[str, str | None], str]]


def walked(topology: Topology, events: list[Event]) -> Walked:
    """Return the passages in view, and the walk of each passage, once all are looked at again."""
    walks = Walks(topology)
    for event in events:
        walks.observe(event)
    walks.revised(events[-1].t + REVISE_SECONDS + 60.0)
    steps = {(step.camera, step.track): step.walk for step in walks._memory.steps()}
    return {key for key, _ in walks._memory.open.passages()}, steps


@pytest.mark.parametrize("order", [shuffled, swapped])
@pytest.mark.parametrize("seed", range(3))
def test_walks_are_those_in_order_of_time(
    learned: Topology, seed: int, order: Callable[[np.random.Generator, list[Event]], list[Event]]
) -> None:
    """Objects that cross two views, one a minute; the last one stays."""
    events = [
        Event(camera, kind, T0 + 60.0 * number + after, x, 0.5, str(number))
        for number in range(30)
        for camera, kind, after, x in (
            ("a", "entry", 0.0, 0.12),
            ("a", "exit", 4.0, 0.88),
            ("b", "entry", 13.0, 0.12),
            ("b", "exit", 17.0, 0.88),
        )
    ][:-1]
    in_view, walks = walked(learned, order(np.random.default_rng(seed), events))

    assert (in_view, walks) == walked(learned, events)
    assert in_view == {("b", "29")}
    assert len(set(walks.values())) == 30


def test_an_entry_heard_late_does_not_continue_a_later_one(learned: Topology) -> None:
    """Else each of two objects in view could be before the other."""
    walks = Walks(learned)
    late, later = Event("a", "entry", T0, 0.12, 0.5, "1"), Event("b", "entry", T0 + 1.0, 0.12, 0.5)
    here, there = (walks._prepared_version.zone_of(event) for event in (late, later))
    hazards, number = walks._hazards, {name: k for k, name in enumerate(walks._hazards.cameras)}
    pairs = sorted(
        zone * len(number) + number[camera] for zone, camera in ((here, "b"), (there, "a"))
    )
    hazards._before = np.array([*pairs, -1]), np.array([0.5, 0.5, 0.0])

    walks.observe(later)
    match = walks.observe(late)
    assert match is not None
    assert match.from_ == []
    [revised] = walks.revised(T0 + REVISE_SECONDS + 1.0)
    assert (revised.camera, revised.walk) == ("b", match.walk)
