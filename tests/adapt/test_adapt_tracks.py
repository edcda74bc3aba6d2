"""The output of any tracker becomes events, as in a slow version of the conversion."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from camtopod.adapt import tracks
from camtopod.client import TrackEvents
from camtopod.records import Event

SIZE = (200, 100)
BOX = [10, 20, 30, 60]


def fed(frames: list[tuple[float, dict[Any, list[float]]]], **options: Any) -> list[Event]:
    """Return all events of frames (time, boxes by id)."""
    events = TrackEvents("c", SIZE, **options)
    found = [e for t, boxes in frames for e in events.update(list(boxes), list(boxes.values()), t)]
    return found + events.close()


# --- against a slow twin --------------------------------------------------------------------------


def by_definition(
    frames: list[tuple[float, dict[Any, list[float]]]], life: float, lost: float
) -> set[Any]:
    """Return the passages by their definition.

    A passage is the sightings of one id without a gap above ``lost``, from the first to the last,
    if it is longer than ``life``.
    """
    seen = defaultdict(list)
    for t, boxes in frames:
        for number, box in boxes.items():
            seen[number].append((t, box))
    events = set()
    for number, sightings in seen.items():
        passages = [[sightings[0]]]
        for before, now in itertools.pairwise(sightings):
            if now[0] - before[0] > lost:
                passages.append([])
            passages[-1].append(now)
        for passage in passages:
            (start, first), (end, last) = passage[0], passage[-1]
            if end - start < life:
                continue
            if start - frames[0][0] > 2 * tracks.LIFE_SECONDS:
                events.add(("entry", str(number), start, *foot(first)))
            if end != frames[-1][0]:
                events.add(("exit", str(number), end, *foot(last)))
    return events


def foot(box: list[float]) -> tuple[float, float]:
    x, y = (box[0] + box[2]) / 2 / SIZE[0], box[3] / SIZE[1]
    return round(min(max(x, 0), 1), 4), round(min(max(y, 0), 1), 4)


boxes = st.tuples(
    st.integers(-50, 250), st.integers(-50, 250), st.integers(2, 90), st.integers(2, 90)
).map(lambda box: [box[0], box[1], box[0] + box[2], box[1] + box[3]])
views = st.dictionaries(st.integers(0, 4), boxes, max_size=4)


@given(
    st.lists(st.tuples(st.integers(1, 12), views), min_size=1, max_size=40),
    st.integers(0, 8),
    st.integers(1, 10),
)
def test_passages_are_those_of_the_definition(
    steps: list[tuple[int, dict[int, Any]]], life: int, lost: int
) -> None:
    """Times in quarters of a second, so that all arithmetic is exact."""
    times = itertools.accumulate(step for step, _ in steps)
    frames = [(t / 4, view) for t, (_, view) in zip(times, steps, strict=True)]
    found = fed(frames, life_seconds=life / 4, lost_seconds=lost / 4)
    assert {(e.kind, e.track, e.t, e.x, e.y) for e in found} == by_definition(
        frames, life / 4, lost / 4
    )
    assert len(found) == len({(e.kind, e.track, e.t) for e in found})


def counted_by_definition(sightings: list[tuple[float, str]]) -> set[tuple[str, float]]:
    """Return the events of a person's track: it counts from the first sighting on at which it has
    lived and no majority is against it.
    """
    events = set()
    passages: list[list[tuple[float, str]]] = []
    for t, kind in sightings:
        if not passages or t - passages[-1][-1][0] > tracks.LOST_SECONDS:
            passages.append([])
        passages[-1].append((t, kind))
    votes: list[int] = []
    for passage in passages:
        start = passage[0][0]
        votes = [1 if sum(votes) > 0 else -1 if sum(votes) < 0 else 0] if votes else []
        counts = False
        for t, kind in passage:
            votes += [1 if kind == "person" else -1] if kind else []
            counts |= t - start >= tracks.LIFE_SECONDS and votes != [] and sum(votes) >= 0
        if counts:
            events |= {("entry", start), ("exit", passage[-1][0])}
    return events


@given(
    st.lists(
        st.tuples(st.sampled_from((0.25, 0.5, 3.0)), st.sampled_from(("", "person", "dog"))),
        max_size=30,
    )
)
def test_a_track_counts_by_the_majority_of_its_sightings(steps: list[tuple[float, str]]) -> None:
    times = itertools.accumulate((step for step, _ in steps), initial=2.0)
    sightings = [(t, kind) for t, (_, kind) in zip(times, steps, strict=False)]
    events = TrackEvents("c", SIZE, wanted_labels=("Person",))
    found = events.update([], [], 0.0)
    for t, kind in sightings:
        found += events.update([1], [BOX], t, [kind])
    found += events.update([], [], 1000.0) + events.close()
    assert {(e.kind, e.t) for e in found} == counted_by_definition(sightings)
    assert len(found) == len({(e.kind, e.t) for e in found})


def test_events_are_reported_in_time_and_numbered_without_a_gap() -> None:
    """None is reported later than life or lost and a frame after its time: the lateness of the
    learner is 5 s.
    """
    events = TrackEvents("c", SIZE, boot="b")
    ages, seqs = [], []
    for n in range(400):
        t = n / 10
        walkers = {99: BOX} | {
            k: [k, 0, k + 9, 50] for k in range(20) if 2 * k <= t <= 2 * k + 5 + k / 7
        }
        for event in events.update(list(walkers), list(walkers.values()), t):
            ages.append(t - event.t)
            seqs.append(event.seq)
    assert len(ages) > 30
    assert max(ages) <= tracks.LOST_SECONDS + 0.1 + 1e-9
    assert tracks.LOST_SECONDS + tracks.LIFE_SECONDS < 5
    assert seqs == list(range(len(seqs)))


# --- what trackers hand out -----------------------------------------------------------------------


def test_what_is_not_tracked_is_counted_and_nothing_else() -> None:
    events = TrackEvents("c", SIZE)
    for n in range(10):
        t = n / 5
        assert events.update(None, np.array([BOX, BOX]), t) == []
        assert events.update(None, np.empty((0, 4)), t) == []
        assert events.update([None, -1, math.nan], [BOX, BOX, BOX], t) == []
        assert events.update([3], [[math.nan, 0, 5, 5]], t) == []
    assert events.close() == []
    assert (events.untracked_count, events.unusable, events.entries) == (50, 10, 0)


def test_who_is_in_view_at_the_start_has_not_come_in_and_at_the_end_not_left() -> None:
    frames = [(n / 10, {1: BOX} if n < 20 else {}) for n in range(30)]
    assert [(e.kind, e.t) for e in fed(frames)] == [
        ("exit", 1.9)
    ]  # close: out of sight in the last frame
    for first, entries in (
        (9, []),
        (11, [("entry", 1.1)]),
    ):  # tenths of a second after the first frame
        frames = [(n / 10, {1: BOX} if n >= first else {}) for n in range(30)]
        assert [(e.kind, e.t) for e in fed(frames)] == entries


def test_memory_has_a_limit() -> None:
    events = TrackEvents("c", SIZE, tracks_max=3)
    for n in range(500):  # a tracker that gives everything a new id
        events.update(range(5 * n, 5 * n + 5), [BOX] * 5, n / 100)
        assert events.statistics()["tracks"] <= 3
    assert events.refused_count > 0


def test_objects_that_are_held_count_towards_the_limit() -> None:
    events = TrackEvents("c", SIZE, tracks_max=3)
    for n in range(5):
        events.update([n], [BOX], n / 100)
        events.hold(n)
    assert [events.follows(n) for n in range(5)] == [True, True, True, False, False]
    assert events.refused_count == 2


def test_a_clock_that_is_set_back_begins_anew_and_a_frame_out_of_order_is_left_out() -> None:
    events = TrackEvents("c", SIZE)
    events.update([], [], 99.0)
    events.update([1], [BOX], 100.2)
    assert events.update([1], [BOX], 99.9) == []
    assert events.late == 1
    assert [e.t for e in events.update([1, 2], [BOX, BOX], 100.8)] == [100.2]
    for t in (50.0, 50.6, 51.2, 51.8):
        assert events.update([1], [BOX], t) == []
    assert events.late == 5, "they may be old frames"
    assert events.update([1], [BOX], 52.4) == []
    assert events.statistics()["tracks"] == 1
    assert events.update([1], [BOX], 53.0) == [], "it was there when the time began anew"
    assert [(e.kind, e.t) for e in events.update([], [], 60.0)] == [("exit", 53.0)]


@pytest.mark.parametrize("back", [2.5, 60.0, 1e9])
@pytest.mark.parametrize("repeats", [1, 4])
def test_old_frames_change_nothing(back: float, repeats: int) -> None:
    """They come late, or again; a few in a row, too."""
    frames: list[Any] = [
        (n / 10, {1: [n, 0, n + 9, 50]} if 20 <= n < 80 else {}) for n in range(120)
    ]
    old = [(t - back, boxes) for t, boxes in frames[60 : 60 + repeats]]
    assert fed([*frames[:65], *old, *frames[65:]]) == fed(frames)
    again = [frames[k] for k in range(120) for _ in range(2)]
    assert fed(again) == fed(frames)


def test_an_object_that_is_held_stays_until_it_is_seen_again_or_ends() -> None:
    for ending, times in (
        (False, [("entry", 2.0), ("exit", 102.0)]),
        (True, [("entry", 2.0), ("exit", 3.0)]),
    ):
        events = TrackEvents("c", SIZE)
        found = events.update([], [], 0.0)
        for t in (2.0, 3.0):
            found += events.update([1], [BOX], t)
        events.hold(1)
        for t in range(4, 100):
            found += events.update([], [], float(t))
        found += events.lose()
        assert events.follows(1)
        if ending:
            found += events.end(1)
        else:
            found += events.update([1], [BOX], 102.0) + events.update([], [], 110.0)
        assert [(e.kind, e.t) for e in found] == times
    events.update([2], [BOX], 200.0)
    events.update([2], [BOX], 201.0)
    events.hold(2)
    left = events.update([], [], 201.0 + tracks.IDLE_SECONDS_MAX + 1)
    assert [(e.kind, e.t) for e in left] == [("exit", 201.0)]


@pytest.mark.parametrize(
    "box",
    [[0, 0, 0, 0], [50, 40, 50, 90], [90, 40, 50, 90], [50, 90, 60, 40], [0.1, 0.2, 0.3, 0.4]],
    ids=["zeros", "no width", "right below left", "bottom above top", "fractions for pixels"],
)
def test_what_cannot_be_a_box_is_counted_and_not_used(box: list[float]) -> None:
    events = TrackEvents("c", SIZE)
    found = [e for n in range(50) for e in events.update([1] * (n > 9), [box] * (n > 9), n / 10)]
    assert (found + events.close(), events.unusable) == ([], 40)


def test_a_box_counts_if_some_of_it_lies_in_the_picture() -> None:
    """Its foot point is clipped."""
    width, height = SIZE
    for box, place in (
        ([-90, 10, 10, 3 * height], (0.0, 1.0)),
        ([width - 5, 10, width + 200, 50], (1.0, 50 / height)),
        ([0, -100, 20, 10], (10 / width, 10 / height)),
    ):
        events = TrackEvents("c", SIZE, outside_max=0.1)
        found = events.update([], [], 0.0)
        for t in (2.0, 3.0):
            found += events.update([1], [box], t)
        assert [(e.x, e.y) for e in found] == [pytest.approx(place, abs=1e-3)]
        assert events.outside == 0
    events.update([2], [[2 * width, 0, 2 * width + 9, 9]], 4.0)
    assert events.outside == 1


def test_nonsense_is_said_at_once() -> None:
    for camera, size, options in (
        ("a b", SIZE, {}),
        ("c", (5, math.nan), {}),
        ("c", SIZE, {"lost_seconds": 0}),
        ("c", SIZE, {"life_seconds": -1}),
        ("c", SIZE, {"boot": "b" * 65}),
    ):
        with pytest.raises(ValueError, match=r"camera|size|seconds|boot"):
            TrackEvents(camera, size, **options)

    events = TrackEvents("c", SIZE)
    for boxes in ([BOX], np.zeros((4, 2)), np.zeros(8), np.zeros((1, 8))):
        with pytest.raises(ValueError, match=r"2 ids.*n ids need boxes \(n, 4\)"):
            events.update([1, 2], boxes, 0.0)
    with pytest.raises(ValueError, match="1 ids, but 2 kinds"):
        events.update([1], [BOX], 0.0, ["person", "dog"])
    with pytest.raises(ValueError, match="finite"):
        events.update([1], [BOX], math.nan)
    assert events.statistics()["tracks"] == 0


def test_the_label_is_the_most_frequent_kind_that_counts() -> None:
    """Equally frequent ones go by name; that of parts, and of what is not wanted, is none."""
    for wanted, kinds, label in (
        ((), ["Car", "van", "car", ""], "car"),
        ((), ["van", "bus"], "bus"),
        ((), ["person", "face", "person", "face"], "person"),
        (("person",), ["person", "dog", "person", "dog"], "person"),
        ((), ["", ""], None),
    ):
        one = tracks.TrackEvents("gate", (1, 1), wanted_labels=wanted)
        events = one.update([], [], 0.0)
        for k in range(8):
            kind = [kinds[k % len(kinds)]]
            events += one.update([1], [[0.1, 0.1, 0.2, 0.2]], 2.0 + 0.25 * k, kind)
        events += one.update([], [], 9.0)

        assert [event.kind for event in events] == ["entry", "exit"]
        assert events[-1].label == label


def test_a_track_that_is_lost_and_found_keeps_its_label() -> None:
    """A program may send the kind only once."""
    one = tracks.TrackEvents("gate", (1, 1))
    one.update([], [], 0.0)
    for t, kind in ((2.0, "car"), (2.5, ""), (3.0, ""), (9.0, ""), (9.5, ""), (10.0, "")):
        one.update([1], [[0.1, 0.1, 0.2, 0.2]], t, [kind])

    assert [event.label for event in one.update([], [], 20.0)] == ["car"]
