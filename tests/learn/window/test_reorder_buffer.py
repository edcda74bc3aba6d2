"""The reorder buffer: verdicts, and the same output for any order of input."""

from __future__ import annotations

import random

import pytest
from hypothesis import example, given, strategies as st

from camtopod.event_time import MICROSECONDS, microseconds
from camtopod.learn.window.reorder_buffer import ReorderBuffer
from camtopod.records import Event


def event(t: float, camera: str = "a", kind: str = "entry", **rest: object) -> Event:
    return Event(camera, kind, t, **rest)  # type: ignore[arg-type]


def out(intake: ReorderBuffer) -> list[Event]:
    return [event for _, event in intake.take_until(10**18)]


# --- verdicts ---


def test_verdicts_and_counts() -> None:
    intake = ReorderBuffer(5.0, 2)
    assert intake.receive(event(100, boot="x", seq=1)) == "accepted"
    assert intake.receive(event(100, boot="x", seq=1)) == "duplicate"
    assert intake.receive(event(100, boot="y", seq=1)) == "accepted"
    assert intake.receive(event(100, camera="b", boot="x", seq=1)) == "accepted"
    assert intake.receive(event(100, camera="c")) == "refused"
    assert intake.receive(event(95)) == "accepted"
    assert intake.receive(event(94.999999)) == "late"
    assert intake.receive(event(94.9, boot="x", seq=2)) == "late"
    assert intake.receive(event(94.9, boot="x", seq=2)) == "duplicate"
    assert intake.state.counts == {"accepted": 4, "duplicate": 2, "late": 2, "refused": 1}
    assert len(intake.state.held) == 6
    assert [t for t, _ in intake.take_until(microseconds(95.0))] == [
        94_900_000,
        94_999_999,
        95_000_000,
    ]
    assert intake.receive(event(94.9, boot="x", seq=2)) == "duplicate", "learned before"


def test_the_watermark_trails_and_only_rises() -> None:
    intake = ReorderBuffer(5.0, 9)
    assert intake.time.state.watermark_us is None
    intake.time.advance(999 * MICROSECONDS)  # nothing has come: nobody is late
    assert intake.time.state.watermark_us is None
    assert intake.oldest_held_us is None
    intake.receive(event(100))
    assert intake.time.state.watermark_us == 95 * MICROSECONDS
    intake.time.advance(90 * MICROSECONDS)
    assert intake.time.state.watermark_us == 95 * MICROSECONDS
    intake.time.advance(110 * MICROSECONDS)
    assert intake.time.state.watermark_us == 105 * MICROSECONDS
    assert intake.receive(event(104)) == "late"
    assert intake.receive(event(105)) == "accepted"
    assert intake.oldest_held_us == 100 * MICROSECONDS


def test_take_is_inclusive_and_leaves_the_rest() -> None:
    intake = ReorderBuffer(100.0, 9)
    for t in (3, 1, 2, 2.000001):
        intake.receive(event(t))
    assert [e.t for _, e in intake.take_until(microseconds(2))] == [1, 2]
    assert len(intake.state.held) == 2
    assert [t for t, _ in intake.take_until(microseconds(3))] == [2_000_001, 3_000_000]
    assert intake.take_until(10**18) == []


# --- order ---

EVENTS = st.lists(
    st.builds(
        Event,
        st.sampled_from(["a", "b"]),
        st.sampled_from(["entry", "exit"]),
        st.integers(-40, 40).map(float),
        st.sampled_from([0.25, 0.5]),
        st.sampled_from([0.25, 0.5]),
        st.sampled_from([None, "", "0", "1", 0, 1]),
    ),
    max_size=40,
)


@given(EVENTS, st.randoms(use_true_random=False))
def test_any_order_within_the_lateness_gives_the_same(
    events: list[Event], chance: random.Random
) -> None:
    """Also with duplicates and ticks in between."""
    numbered = [
        Event(e.camera, e.kind, e.t, e.x, e.y, e.track, boot="x", seq=k)
        for k, e in enumerate(events)
    ]
    plain, mixed = ReorderBuffer(5.0, 9), ReorderBuffer(5.0, 9)
    for e in sorted(numbered, key=lambda e: e.t):
        assert plain.receive(e) == "accepted"
    arrivals = [(e.t + chance.uniform(0, 5), e) for e in numbered for _ in range(2)]
    for at, e in sorted(arrivals, key=lambda arrival: arrival[0]):
        assert mixed.receive(e) in ("accepted", "duplicate")
        mixed.time.advance(int(at * MICROSECONDS) - 1)
    assert mixed.state.counts["duplicate"] == len(events)
    assert out(mixed) == out(plain)


@example([Event("a", "exit", 0.0, track=track) for track in (None, "", 0)], random.Random(1))
@example([Event("a", "exit", 0.0, label=label) for label in (None, "bus", "car")], random.Random(1))
@given(EVENTS, st.randoms(use_true_random=False))
def test_ties_do_not_depend_on_the_order(events: list[Event], chance: random.Random) -> None:
    first, second = ReorderBuffer(100.0, 9), ReorderBuffer(100.0, 9)
    shuffled = events[:]
    chance.shuffle(shuffled)
    for intake, order in ((first, events), (second, shuffled)):
        for e in order:
            intake.receive(e)

    def names(taken: list[Event]) -> list[tuple[object, ...]]:
        return [
            (e.t, e.camera, e.kind, e.x, e.y, None if e.track is None else str(e.track), e.label)
            for e in taken
        ]

    assert names(out(first)) == names(out(second))


# --- clocks ---


def test_a_single_clock_that_is_ahead_makes_nobody_late() -> None:
    """Camera b is 40 s ahead; without an allowance the others would be late."""
    for ahead, late in ((60.0, 0), (0.0, 98 + 100)):
        intake = ReorderBuffer(5.0, 9, ahead)
        for t in range(100):
            for camera, error in (("a", 0.0), ("b", 40.0), ("c", 0.5)):
                intake.receive(event(t + error, camera))
        assert intake.state.counts["late"] == pytest.approx(late, abs=2)
        assert intake.time.state.watermark_us == microseconds(99.5 - 5 if ahead else 139 - 5)


def test_one_that_is_further_ahead_is_obeyed_as_time_may_have_gone_on() -> None:
    intake = ReorderBuffer(5.0, 9, 60.0)
    for camera in "ab":
        intake.receive(event(100, camera))
    intake.receive(event(1000, "a"))
    assert intake.time.state.watermark_us == microseconds(1000 - 60 - 5)
    assert intake.receive(event(934, "b")) == "late"
    assert intake.receive(event(936, "b")) == "accepted"


def test_silent_cameras_hold_nobody_up_for_longer() -> None:
    intake = ReorderBuffer(5.0, 9, 60.0)
    intake.receive(event(0, "b"))
    for t in range(300):
        intake.receive(event(t, "a"))
    assert intake.time.state.watermark_us == microseconds(299 - 60 - 5)
    intake.time.advance(microseconds(300))
    assert intake.time.state.watermark_us == microseconds(300 - 5), (
        "when time is told, it is told for all"
    )


@given(EVENTS)
def test_event_time_is_where_a_second_camera_has_come_to(events: list[Event]) -> None:
    intake, newest = ReorderBuffer(5.0, 9, 60.0), dict[str, float]()
    for e in events:
        before = intake.time.state.watermark_us
        if intake.receive(e) == "late":
            continue
        newest[e.camera] = max(newest.get(e.camera, e.t), e.t)
        reached = sorted(newest.values())[-2 if len(newest) > 1 else -1]
        wanted = microseconds(max(reached, max(newest.values()) - 60.0)) - intake.time.lateness_us
        assert intake.time.state.watermark_us == (wanted if before is None else max(wanted, before))
