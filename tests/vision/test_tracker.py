"""Tracks from blobs: what is one passage, and when its events are told."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from rendered_scenes import FPS, Person, Place, Scene, line

from camtopod.records import Event
from camtopod.vision.boxes import Box, union
from camtopod.vision.detect import Blob
from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import VisionSettings
from camtopod.vision.track import Crossings, FrameView, IgnoredAreas, Tracker

WIDTH, HEIGHT = 320, 240


def tracked(
    frames: list[list[Box]], labels: Sequence[str] = ("",), is_trusted: bool = False
) -> list[Event]:
    """Return the events of the boxes seen in each frame, and in some empty frames around them.

    labels: what a detector says that the boxes of the frames are, one frame after another.
    is_trusted: the boxes are those of a trusted detector.
    """
    ignored = IgnoredAreas(np.full((HEIGHT, WIDTH), 255, np.uint8))
    crossings = Crossings("cam", WIDTH, HEIGHT, (), ignored, lambda decision: None)
    tracker = Tracker(VisionSettings(), crossings, iter(range(1, 1000)))
    crossings.begin(0.0, ignored)
    events: list[Event] = []
    for k, boxes in enumerate([*[[]] * 10, *frames, *[[]] * 20]):
        blobs = [
            Blob(*map(float, box), (box[0] + box[2]) / 2, label=labels[k % len(labels)])
            for box in boxes
        ]
        view = (0.0, 0.0, float(WIDTH), float(HEIGHT))
        events += tracker.step(FrameView(k / FPS, view, is_trusted), blobs)
    return events


def test_what_moves_by_its_own_length_in_each_frame_is_one_passage() -> None:
    """A car of 50 x 25 pixels is assigned by its area: head and foot are outside every gate."""
    frames: list[list[Box]] = [
        [(max(0, x - 50), 100, min(WIDTH, x), 125)] for x in range(20, WIDTH + 50, 50)
    ]
    assert [event.kind for event in tracked(frames)] == ["entry", "exit"]


def test_a_bicycle_crosses_the_view_in_less_than_a_second() -> None:
    """It moves by more than its height from frame to frame, and is seen five or six times."""
    for seconds in (0.8, 1.2):
        ways = [((-0.06, 0.75), (1.06, 0.75)), ((1.06, 0.85), (-0.06, 0.85))]
        people = [
            Person(line(4.0 + 4.3 * k, *way, seconds), tall=0.33, seed=k)
            for k, way in enumerate(ways)
        ]
        events = Scene(people).events(15.0)
        assert [(event.kind, round(event.x or 0.0)) for event in events] == [
            ("entry", 0),
            ("exit", 1),
            ("entry", 1),
            ("exit", 0),
        ], seconds


def test_what_is_seen_twice_or_turns_back_at_once_has_not_crossed_the_view() -> None:
    def at(x: float) -> list[Box]:
        return [(max(0.0, x - 30), 100.0, x, 180.0)]

    assert tracked([at(80), at(155)]) == []
    assert tracked([at(20), at(95), at(20)]) == []
    assert len(tracked([at(80), at(155), at(230), at(305)])) == 2


def test_a_fragment_that_flies_off_beside_a_walker_is_nobody() -> None:
    def at(k: int) -> list[Box]:
        walker = (6.0 * k, 100.0, 6.0 * k + 30, 180.0)
        x = 320.0 - 75 * (k - 45)
        return [walker, (x - 30, 100.0, x, 180.0)] if 45 <= k < 49 else [walker]

    assert [event.kind for event in tracked([at(k) for k in range(52)])] == ["entry", "exit"]


def test_who_enters_where_another_has_just_left_is_another() -> None:
    """Two passages of people who meet at the border."""

    def at(x: float, width: int, bottom: float) -> Box:
        return (max(0.0, x - width), bottom - 2.5 * width, min(float(WIDTH), x), bottom)

    frames: list[list[Box]] = [[at(x, 20, 150)] for x in range(15, WIDTH + 10, 5)]
    frames += [[at(x, 26, 170)] for x in range(WIDTH + 10, 0, -14)]
    events = tracked(frames)
    assert sorted(event.kind for event in events) == ["entry", "entry", "exit", "exit"]
    assert len({event.track for event in events}) == 2


def test_who_comes_in_before_another_is_not_the_one_inside() -> None:
    """Both are in one blob, from the newcomer's first sighting until the one inside has passed."""

    def inside(k: int) -> Box:
        return (max(0, 4 * k - 20), 60, min(WIDTH, 4 * k), 110)

    def newcomer(k: int) -> Box:
        return (max(0, 595 - 8 * k), 230 - 2 * k, 635 - 8 * k, HEIGHT - 2 * max(0, k - 56))

    frames = [[inside(k)] for k in range(2, 50)]
    frames += [[union(inside(k), newcomer(k))] for k in range(50, 56)]
    frames += [[inside(k), newcomer(k)] for k in range(56, 79)]
    frames += [[inside(k)] for k in range(79, 84)]
    events = tracked(frames)
    assert [event.kind for event in events] == ["entry", "entry", "exit", "exit"]
    first, second, *_ = events
    assert 0.9 < second.y <= 1.0
    assert abs(second.t - (10 + 48) / FPS) < 0.3
    assert {(event.track, event.x > 0.9) for event in events[2:]} == {
        (first.track, True),
        (second.track, False),
    }


def test_a_head_without_a_body_is_no_person() -> None:
    """A coat of the colour of the wall behind it leaves the head and the legs."""

    def walk(seen: Callable[[int], list[Box]]) -> list[list[Box]]:
        return [seen(x) for x in range(WIDTH - 8, 40, -6)]

    frames = walk(lambda x: [(x, 80, min(WIDTH, x + 20), 130)])
    frames += [[]] * 15 + walk(lambda x: [(x, 90, min(WIDTH, x + 20), 140)])
    frames += [[]] * 15 + walk(
        lambda x: [(x, 105, min(WIDTH, x + 20), 130), (x + 6, 80, min(WIDTH, x + 14), 88)]
    )
    assert sum(event.kind == "entry" for event in tracked(frames)) == 3


def test_the_edge_of_a_door_leaf_that_swings_is_nobody() -> None:
    """It moves towards the border where somebody comes in, and back, and a pane shows where the leaf was."""

    def leaf(k: int) -> list[Box]:
        x = 44.0 + 2.5 * abs(k - 16)
        edge = (x, 44.0, x + 4, 155.0)
        return [] if k > 32 else [edge, (53.0, 59.0, 84.0, 123.0)] if 14 <= k <= 17 else [edge]

    def walker(k: int) -> list[Box]:
        x = 7.0 * (k - 17)
        return [(max(0.0, x - 20), 86.0, min(WIDTH, x), 146.0)] if k > 17 else []

    first, last = tracked([leaf(k) + walker(k) for k in range(65)])
    assert (first.kind, last.kind, first.track) == ("entry", "exit", last.track)
    assert first.x < 0.1 < 0.9 < last.x


def halting(start: float, at: Place) -> Callable[[float], Place | None]:
    """Return a walk that begins at the border, stands at ``at`` for six seconds, and goes on."""
    on = line(start + 6.0, at, (1.05, 0.9), 5.0)
    return lambda t: at if start < t < start + 6.0 else on(t)


def test_who_stands_at_a_border_first_has_entered_when_they_came() -> None:
    """That they are people is known as they walk on, six seconds later."""
    people = [Person(halting(4.0, (0.01 * k, 0.4 + 0.3 * k)), seed=k) for k in range(3)]
    entries = [event for event in Scene(people).events(18.0) if event.kind == "entry"]
    assert [event.t for event in entries] == pytest.approx([4.1] * 3, abs=0.6)


@pytest.mark.parametrize(("pause", "tracks"), [(2.2, 1), (5.0, 2)])
def test_who_is_in_view_before_a_short_pause_and_after_it_is_one(pause: float, tracks: int) -> None:
    """The walk is straight on; what has entered .3 s before the pause is not known until later."""
    for start in (5.0, 7.4):
        scene = Scene([Person(line(start, (-0.05, 0.7), (1.05, 0.7), 9.0))])
        pipeline, events = ViewPipeline("cam", VisionSettings()), []
        for k in range(round(19 * FPS)):
            if not 8.0 < k / FPS < 8.0 + pause:
                events += pipeline.process(k / FPS, scene.picture(k / FPS))
        if tracks == 1:
            assert [event.kind for event in events] == ["entry", "exit"], start
        assert len({event.track for event in events}) == (tracks if start == 5.0 else 1)


@pytest.mark.parametrize(("every", "kinds"), [(1, ["entry", "exit"]), (3, [])])
def test_what_is_seen_in_a_third_of_the_frames_is_nobody(every: int, kinds: list[str]) -> None:
    """Leaves flicker; a person is seen most of the time."""
    frames: list[list[Box]] = [
        [(3 * k, 100, 3 * k + 20, 150)] if k % every == 0 else [] for k in range(110)
    ]
    assert [event.kind for event in tracked(frames)] == kinds


def test_a_part_of_somebody_who_is_seen_leaves_with_them() -> None:
    """As a bag that differs from a coat, and from the scene behind both."""
    frames: list[list[Box]] = []
    for x in range(-20, WIDTH + 20, 4):
        frames.append([(max(x, 0), 100, min(x + 40, WIDTH), 200)] if x < WIDTH else [])
        if 60 < x < WIDTH - 10:
            frames[-1].append((x + 8, 120, min(x + 32, WIDTH), 190))
    assert [event.kind for event in tracked(frames)] == ["entry", "exit"]


def test_who_is_hidden_by_another_has_not_left() -> None:
    """A trusted detector's objects leave in mid-view, but not behind a person who stands there."""
    frames: list[list[Box]] = []
    for k in range(80):
        x, other_x = min(6 * k, 150), min(6 * (k - 15), 156 + 6 * max(k - 60, 0))
        hidden = other_x >= 150
        frames.append([(x, 100, x + 20, 150)] * (not hidden) + [(other_x, 96, other_x + 24, 152)])
    frames = [[box for box in boxes if box[2] > 0] for boxes in frames]
    kinds = [event.kind for event in tracked(frames, is_trusted=True)]
    assert kinds == ["entry", "entry", "exit"]


def test_the_label_of_a_track_is_the_detectors_most_frequent() -> None:
    """Motion alone has none."""
    frames = [[(8 * k, 80, 8 * k + 40, 180)] for k in range(35)]
    for labels, expected in ((["car", "", "Car", "van"], "car"), ([""], None)):
        events = tracked(frames, labels)

        assert events
        assert {event.label for event in events} == {expected}
