"""From rendered frames to events: what counts as an entry or exit, and what does not."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from rendered_scenes import FPS, HEIGHT, WIDTH, Person, Picture, Place, Scene, line

from camtopod.records import Event
from camtopod.vision.detect import MotionDetector
from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import VisionSettings


def passages(events: list[Event]) -> list[tuple[str, str]]:
    """Return (kind, side of the picture) in order of time."""
    return [(event.kind, side(event)) for event in sorted(events, key=lambda event: event.t)]


def side(event: Event) -> str:
    assert event.x is not None
    assert event.y is not None
    distances = {"left": event.x, "right": 1 - event.x, "top": event.y, "bottom": 1 - event.y}
    nearest = min(distances, key=distances.__getitem__)
    return nearest if distances[nearest] < 0.12 else "inside"


def test_one_passage_is_an_entry_and_an_exit_with_capture_times() -> None:
    scene = Scene([Person(line(5.0, (-0.05, 0.7), (1.05, 0.5), 8.0))])
    events = scene.events(18)

    assert passages(events) == [("entry", "left"), ("exit", "right")]
    entry, leaving = events
    assert entry.track == leaving.track
    assert entry.t == pytest.approx(5.2, abs=0.5)
    assert leaving.t == pytest.approx(12.8, abs=0.5)
    assert entry.y == pytest.approx(0.7, abs=0.06)
    assert leaving.y == pytest.approx(0.5, abs=0.06)
    assert entry.boot is None
    assert entry.seq is None


@pytest.mark.parametrize(("a", "b"), [((-0.1, 0.8), (1.1, 0.8)), ((0.4, 1.3), (0.6, -0.1))])
def test_who_is_seen_late_has_crossed_the_border_where_and_when_it_was(a: Place, b: Place) -> None:
    """The first and last pictures within the border miss the person, who walks straight on."""
    way = line(5.0, a, b, 7.0)

    def where(t: float) -> Place | None:
        place = way(t)
        hidden = place is None or min(*place, 1 - place[0], 1 - place[1]) < 0.06
        return None if hidden else place

    late, early = Scene([Person(where)]).events(15.0)
    entry, exit_ = Scene([Person(way)]).events(15.0)
    for seen, true in ((late, entry), (early, exit_)):
        assert seen.kind == true.kind
        assert side(seen) == side(true)
        assert seen.t == pytest.approx(true.t, abs=0.7), "1.3 s late at the bottom border"
        assert seen.x == pytest.approx(true.x, abs=0.08)
        assert seen.y == pytest.approx(true.y, abs=0.05)


def test_a_quiet_scene_has_no_events_whatever_the_light_does() -> None:
    assert Scene([], noise=3.0).events(20) == []
    assert Scene([], light=lambda t: 0.75 if 8 < t < 14 else 1.0).events(20) == []
    assert Scene([], light=lambda t: 1.0 + 0.25 * np.sin(t)).events(20) == []


def test_people_are_seen_in_a_portrait_picture_too() -> None:
    """A picture is scaled down to an equal area, whichever of its sides is the longer one."""
    scene = Scene([Person(line(4.0, (-0.05, 0.9), (1.05, 0.8), 5.0), tall=0.6, shade=20)])
    for size in ((640, 360), (360, 640)):
        pipeline, events = ViewPipeline("cam", VisionSettings()), []
        for k in range(round(11 * FPS)):
            events += pipeline.process(k / FPS, cv2.resize(scene.picture(k / FPS), size))
        assert passages(events + pipeline.finish()) == [("entry", "left"), ("exit", "right")]


def test_two_who_cross_are_two_passages() -> None:
    scene = Scene(
        [
            Person(line(5.0, (-0.05, 0.62), (1.05, 0.62), 8.0), seed=1),
            Person(line(5.5, (1.05, 0.7), (-0.05, 0.7), 8.0), shade=220, seed=2),
        ]
    )
    events = scene.events(20)

    assert passages(events) == [
        ("entry", "left"),
        ("entry", "right"),
        ("exit", "right"),
        ("exit", "left"),
    ]
    assert len({event.track for event in events}) == 2


def test_standing_still_is_no_exit() -> None:
    def where(t: float) -> Place | None:
        if t < 9:
            return line(5.0, (-0.05, 0.7), (0.5, 0.7), 4.0)(t)
        return (0.5, 0.7) if t < 25 else line(25.0, (0.5, 0.7), (1.05, 0.7), 4.0)(t)

    events = Scene([Person(where)]).events(34)
    assert passages(events) == [("entry", "left"), ("exit", "right")]
    assert events[0].track == events[1].track


def test_a_passage_that_breaks_behind_a_post_stays_one() -> None:
    def wall(picture: Picture) -> None:
        picture[:, 80:104] = 40

    scene = Scene([Person(line(5.0, (-0.05, 0.7), (1.05, 0.7), 9.0))], front=wall)
    events = scene.events(20)
    assert passages(events) == [("entry", "left"), ("exit", "right")]
    assert events[0].track == events[1].track


def test_who_is_there_from_the_start_has_an_exit_only_and_leaves_no_ghost() -> None:
    def where(t: float) -> Place | None:
        return (0.5, 0.7) if t < 8 else line(8.0, (0.5, 0.7), (1.05, 0.7), 4.0)(t)

    later = Person(line(30.0, (-0.05, 0.7), (1.05, 0.7), 8.0), seed=3)
    events = Scene([Person(where), later]).events(42)
    assert passages(events) == [("exit", "right"), ("entry", "left"), ("exit", "right")]


def test_the_hole_of_who_stood_there_from_the_start_is_followed_no_longer() -> None:
    """It begins as a part of who goes, so that it moves at first, as an object does."""
    goes = line(12.0, (0.5, 0.75), (1.06, 0.75), 4.0)
    walker = Person(lambda t: (0.5, 0.75) if t < 12.0 else goes(t), tall=0.33)
    pipeline, scene, counts = ViewPipeline("cam", VisionSettings()), Scene([walker]), []
    for k in range(round(40 * FPS)):
        pipeline.process(k / FPS, scene.picture(k / FPS))
        counts.append(pipeline.statistics()["tracks_active"])
    assert max(counts) == 2
    assert counts[-1] == 0


def test_a_door_in_mid_view_is_admitted_once_it_was_used_again_and_again() -> None:
    def through_door(start: float) -> Person:
        return Person(line(start, (0.5, 0.55), (-0.05, 0.75), 6.0), seed=round(start))

    starts = [6.0 + 9 * k for k in range(8)]
    events = Scene([through_door(start) for start in starts]).events(starts[-1] + 12)
    exits = [event for event in events if event.kind == "exit"]
    entries = [event for event in events if event.kind == "entry"]
    assert len(exits) == len(starts)
    assert all(side(event) == "left" for event in exits)
    assert 4 <= len(entries) <= 6, "the first ones are not believed"
    assert all(side(event) == "inside" for event in entries)
    assert {event.track for event in entries} < {event.track for event in exits}


def infrared(picture: Picture) -> Picture:
    """A camera's own lamp: less contrast, and a bright spot in the middle."""
    y, x = np.mgrid[0 : 1 : HEIGHT * 1j, 0 : 1 : WIDTH * 1j]
    spot = np.exp(-((x - 0.5) ** 2 + (y - 0.5) ** 2) / 0.08)
    return (0.27 * picture + 12 + 110 * spot).clip(0, 255).astype(np.uint8)


def test_in_the_dark_a_walker_is_one_passage_and_noise_is_none() -> None:
    walker = Person(line(6.0, (-0.05, 0.7), (1.05, 0.6), 8.0), texture=60, shade=20)
    for people, expected in (([], []), ([walker], [("entry", "left"), ("exit", "right")])):
        scene, pipeline, events = (
            Scene(people, noise=0.0),
            ViewPipeline("cam", VisionSettings()),
            [],
        )
        rng = np.random.default_rng(8)
        for k in range(round(18 * FPS)):
            picture = scene.picture(k / FPS)
            dark = 0.2 * picture + 5 + rng.normal(0.0, 0.8, picture.shape)
            events += pipeline.process(k / FPS, dark.clip(0, 255).astype(np.uint8))
        assert passages(events + pipeline.finish()) == expected


def card(picture: Picture) -> Picture:
    """What a recorder shows of a camera that is gone."""
    shown = np.full_like(picture, 8)
    cv2.putText(shown, "NO SIGNAL", (20, 80), 0, 0.9, (255.0,), 2)
    return shown


@pytest.mark.parametrize(
    ("change", "begin", "end"),
    [(infrared, 8, 99), (card, 8, 16)],
)
def test_light_and_cards_are_no_objects_and_people_are_seen_after_them(
    change: Callable[[Picture], Picture], begin: float, end: float
) -> None:
    scene = Scene([Person(line(24.0, (-0.05, 0.7), (1.05, 0.6), 8.0), texture=60)], noise=2.0)
    pipeline, events = ViewPipeline("cam", VisionSettings()), []
    for k in range(round(35 * FPS)):
        picture = scene.picture(k / FPS)
        seen = change(picture) if begin <= k / FPS < end else picture
        events += pipeline.process(k / FPS, seen)
    assert passages(events + pipeline.finish()) == [("entry", "left"), ("exit", "right")]


def test_a_picture_of_another_size_is_another_scene() -> None:
    """Nobody is lost who left before, and numbers of tracks and counts go on."""
    people = [
        Person(line(5.0, (-0.05, 0.7), (1.05, 0.6), 7.0)),
        Person(line(17.0, (1.05, 0.6), (-0.05, 0.7), 5.0)),
    ]
    shown: list[Event] = []
    pipeline = ViewPipeline("cam", VisionSettings(), lambda analysis: shown.extend(analysis.events))
    scene, events = Scene(people), []
    for k in range(round(24 * FPS)):
        picture = scene.picture(k / FPS)
        if k / FPS > 13.0:
            picture = cv2.resize(picture, (120, 160))
        events += pipeline.process(k / FPS, picture)
    events += pipeline.finish()
    assert shown == events
    assert passages(events) == [
        ("entry", "left"),
        ("exit", "right"),
        ("entry", "right"),
        ("exit", "left"),
    ]
    assert len({event.track for event in events}) == 2
    figures = pipeline.statistics()
    assert (figures["entries"], figures["exits"]) == (2, 2)


@pytest.mark.parametrize("pixels", [1, 3])
def test_a_camera_that_shakes_sees_nothing_in_an_empty_scene_and_people_in_a_full_one(
    pixels: int,
) -> None:
    walker = Person(line(5.0, (-0.05, 0.7), (1.05, 0.7), 8.0), shade=20)
    for people, expected in (([], []), ([walker], [("entry", "left"), ("exit", "right")])):
        scene, pipeline, events = Scene(people), ViewPipeline("cam", VisionSettings()), []
        rng = np.random.default_rng(4)
        for k in range(round(18 * FPS)):
            picture = np.roll(
                scene.picture(k / FPS), rng.integers(-pixels, pixels + 1, 2), axis=(0, 1)
            )
            events += pipeline.process(k / FPS, picture)
        assert passages(events + pipeline.finish()) == expected


def test_a_camera_that_drifts_zooms_and_turns_sees_one_walker_once() -> None:
    scene = Scene([Person(line(5.0, (-0.05, 0.7), (1.05, 0.7), 8.0), shade=20)])
    pipeline, events = ViewPipeline("cam", VisionSettings()), []
    for k in range(round(16 * FPS)):
        phase = k / FPS
        by = cv2.getRotationMatrix2D(
            (WIDTH / 2, HEIGHT / 2), np.sin(phase), 1.1 + 0.02 * np.sin(2 * phase)
        )
        by[:, 2] += 3 * np.sin(phase / 2), 2 * np.sin(3 * phase)
        events += pipeline.process(
            k / FPS, cv2.warpAffine(scene.picture(k / FPS), by, (WIDTH, HEIGHT))
        )
    assert passages(events + pipeline.finish()) == [("entry", "left"), ("exit", "right")]


def test_nothing_moves_at_the_borders_of_a_shifted_picture() -> None:
    scene, motion = Scene([], noise=0.5), MotionDetector(VisionSettings())
    for k in range(40):
        shift = (0, 0) if k < 20 else (7, -5)
        frame = motion.filter_noise(np.roll(scene.picture(0.0), shift, axis=(0, 1))[8:-8, 8:-8])
        if k == 10:
            motion.bootstrap([frame])
        if k < 10:
            continue
        found = motion.detect(frame, 1 / FPS)
        if k > 30:
            assert found is not None
            assert not found.change_mask.any()


@pytest.mark.parametrize("seed", range(2))
def test_whatever_the_pictures_events_are_well_formed(seed: int) -> None:
    """Jumping crowds, flashes and gaps cause no error; each track enters and leaves
    at most once.
    """
    rng = np.random.default_rng(seed)

    def wild(own: int) -> Person:
        places = np.random.default_rng(own).uniform(-0.1, 1.1, (40, 2))
        return Person(
            lambda t: tuple(places[int(t) % 40]),
            tall=0.05 + 0.4 * (own % 7) / 7,
            shade=own * 17 % 256,
        )

    scene = Scene([wild(int(own)) for own in rng.integers(0, 1000, 6)])
    pipeline, events, t = ViewPipeline("cam", VisionSettings()), [], 0.0
    for _ in range(250):
        t += float(
            rng.choice(
                [0.01, 1 / FPS, 1 / FPS, 1 / FPS, 0.7, 4.0], p=[0.04, 0.3, 0.3, 0.3, 0.05, 0.01]
            )
        )
        flash = rng.random() < 0.01
        events += pipeline.process(
            t, np.full((HEIGHT, WIDTH), 255, np.uint8) if flash else scene.picture(t)
        )
    events += pipeline.finish()
    seen: dict[tuple[object, str], float] = {}
    for event in events:
        assert 0 <= (event.x or 0.0) <= 1
        assert 0 <= (event.y or 0.0) <= 1
        assert 0 <= event.t <= t
        assert (event.track, event.kind) not in seen
        seen[event.track, event.kind] = event.t
    for (track, kind), when in seen.items():
        if kind == "exit":
            assert seen.get((track, "entry"), 0.0) < when


@pytest.mark.parametrize("tall", [0.3, 0.5])
def test_one_who_walks_alone_is_one(tall: float) -> None:
    man = Person(line(5.0, (-0.05, 0.9), (1.05, 0.9), 8.0), tall=tall)
    assert len(Scene([man]).events(18)) == 2
