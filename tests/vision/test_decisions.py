"""Why a track became an event or not: reasons are handed out, and nothing depends on it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import get_args

import numpy as np
import pytest
from rendered_scenes import FPS, HEIGHT, WIDTH, Person, Place, Scene, line

from camtopod.codec import to_json
from camtopod.records import Event
from camtopod.vision.analysis import Analysis
from camtopod.vision.detect import Blob
from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import Polygon, VisionSettings
from camtopod.vision.track import Crossings, Decision, Recorder, Tracker
from camtopod.vision.track.decisions import Beginning, Ending, Shortfall

CROWD = [
    Person(line(5.0, (-0.05, 0.7), (1.05, 0.5), 8.0)),
    Person(line(7.0, (0.5, 1.25), (1.05, 0.4), 8.0), shade=220, seed=2),
    Person(line(6.0, (1.05, 0.6), (-0.05, 0.65), 9.0), shade=230, seed=3),
    Person(line(8.0, (-0.05, 0.9), (0.5, 0.8), 4.0), seed=4),
    Person(lambda t: (0.2, 0.4) if 9.0 < t < 9.3 else None, seed=5),
    Person(lambda t: (0.8, 0.95) if t > 10.0 else None, seed=6),
]


def analysed(
    scene: Scene, seconds: float, settings: VisionSettings | None = None, gap: float = 0.0
) -> tuple[list[Event], list[Decision], set[int]]:
    """Return events, decisions, and the numbers of all tracks. No frames after ``gap`` for 10 s."""
    decisions: list[Decision] = []
    numbers: set[int] = set()

    def observe(seen: Analysis) -> None:
        decisions.extend(seen.decisions)
        numbers.update(track.number for track in seen.tracks)

    pipeline, events = ViewPipeline("cam", settings or VisionSettings(), observe), []
    for k in range(round(seconds * FPS)):
        t = k / FPS
        if not (gap and gap < t < gap + 10.0):
            events += pipeline.process(t, scene.picture(t))
    return events + pipeline.finish(), decisions, numbers


def of_objects(decisions: list[Decision]) -> list[Decision]:
    """Return the decisions about objects, without those about fragments that never became one."""
    return [decision for decision in decisions if decision.reason not in get_args(Shortfall)]


def reasons(decisions: list[Decision]) -> list[str]:
    return [decision.reason for decision in decisions]


def test_who_is_observed_has_the_same_events() -> None:
    with_observer, _, _ = analysed(Scene(CROWD), 20)
    without = Scene(CROWD).events(20)
    assert len(without) > 4
    assert list(map(to_json, with_observer)) == list(map(to_json, without))


def test_every_track_ends_once_and_every_event_has_its_decision() -> None:
    events, decisions, numbers = analysed(Scene(CROWD), 20)
    ends = {*get_args(Shortfall), *get_args(Ending), "continues"}
    ended = Counter(one.track for one in decisions if one.reason in ends)
    assert set(ended) >= numbers
    assert set(ended.values()) == {1}
    said = [one for one in decisions if one.reason in ("entered", "left", "swapped")]
    assert [(str(one.track), round(one.t, 6)) for one in said] == [(e.track, e.t) for e in events]
    assert [one.place for one in said] == [
        (pytest.approx(e.x, abs=1e-4), pytest.approx(e.y, abs=1e-4)) for e in events
    ]
    assert {*get_args(Beginning)} & ends == {"continues"}


@pytest.mark.parametrize(
    ("a", "b", "edges"),
    [
        ((-0.05, 0.7), (1.05, 0.5), ["left border", "right border"]),
        ((0.5, -0.01), (0.45, 1.25), ["top border", "bottom border"]),
        ((0.5, 1.25), (0.5, -0.01), ["bottom border", "top border"]),
    ],
)
def test_the_border_is_named(a: Place, b: Place, edges: list[str]) -> None:
    _, decisions, _ = analysed(Scene([Person(line(5.0, a, b, 9.0))]), 18)
    assert [one.edge for one in decisions if one.edge] == edges
    assert reasons([one for one in decisions if one.edge]) == ["entered", "left"]


STREET: Polygon = ((0.0, 0.0), (1.0, 0.0), (1.0, 0.25), (0.0, 0.25))
TREE: Polygon = ((0.35, 0.2), (0.65, 0.2), (0.65, 0.95), (0.35, 0.95))


def test_other_edges_are_named() -> None:
    down = Person(line(5.0, (0.5, 0.15), (0.4, 1.25), 8.0))
    _, decisions, _ = analysed(Scene([down]), 18, VisionSettings(ignore=(STREET,)))
    assert [one.edge for one in decisions if one.edge] == ["ignored area", "bottom border"]

    out = Person(line(6.0, (0.5, 0.55), (-0.05, 0.75), 6.0))
    door = VisionSettings(doors=(((0.5, 0.55),),))
    _, decisions, _ = analysed(Scene([out]), 18, door)
    assert [one.edge for one in decisions if one.edge] == ["named door", "left border"]


def test_a_learned_door_is_named() -> None:
    walks = [Person(line(5.0 + 14 * k, (0.5, 0.55), (-0.05, 0.75), 5.0), seed=k) for k in range(5)]
    seen: list[Analysis] = []
    pipeline = ViewPipeline("cam", VisionSettings(), seen.append)
    scene = Scene(walks)
    for k in range(round(75 * FPS)):
        pipeline.process(k / FPS, scene.picture(k / FPS))
    decisions = [one for analysis in seen for one in analysis.decisions]
    begun = [(one.reason, one.edge) for one in decisions if one.reason in get_args(Beginning)]
    assert begun[0] == ("in mid-view", None)
    assert begun[-1] == ("entered", "learned door")
    assert seen[0].learned_doors == []
    x, y = seen[-1].learned_doors[0]
    assert (x / WIDTH, y / HEIGHT) == (pytest.approx(0.5, abs=0.1), pytest.approx(0.55, abs=0.1))


@pytest.mark.parametrize(("heights", "learned"), [(1.2, False), (3.0, True)])
def test_what_moves_in_place_makes_no_door(heights: float, learned: bool) -> None:
    """Such as the fragments of a person who stands, or of a tree."""
    crossings = Crossings("cam", 400, 300)
    tracker = Tracker(VisionSettings(), crossings)
    for k in range(round(90 * FPS)):
        seconds = k / FPS % 30.0 - 5.0
        left = 200.0 + 20.0 * heights * min(max(seconds / 4.0, 0.0), 1.0)
        blob = Blob(left, 150.0, left + 8.0, 170.0, left + 4.0, 100.0)
        blobs = [blob] if 0.0 < seconds < 6.0 else []
        crossings.report(tracker.step(k / FPS, blobs), tracker.active)
    assert bool(crossings.doors.learned(lambda row: 20.0)) == learned


def test_what_never_becomes_an_object() -> None:
    blink = Person(lambda t: (0.3, 0.7) if 6.0 < t < 6.3 else None)
    _, decisions, _ = analysed(Scene([blink]), 12)
    assert set(reasons(decisions)) == {"brief"}
    assert 0.0 < decisions[0].value < decisions[0].least == 0.5
    assert decisions[0].sightings == 2
    assert decisions[0].place == (pytest.approx(0.3, abs=0.05), pytest.approx(0.7, abs=0.1))

    cat = Person(line(5.0, (-0.05, 0.8), (1.05, 0.8), 8.0), tall=0.1)
    events, decisions, _ = analysed(Scene([cat]), 18, VisionSettings(min_height=0.18))
    assert events == []
    assert of_objects(decisions) == []
    assert {(one.value, one.least) for one in decisions if one.reason == "low"} == {(0, 3)}


@pytest.mark.parametrize(
    ("seen", "x", "reason", "value"),
    [
        (lambda k: True, lambda k: 0.0, "still", 0.0),
        (lambda k: True, lambda k: 2.0 * (k % 2), "still", 0.1),
        (lambda k: k % 3 == 0, lambda k: 1.0 * k, "patchy", 3 / 7),
        (lambda k: k < 3, lambda k: 2.0 * k, "brief", 2 / FPS),
    ],
)
def test_what_a_tentative_track_lacks(
    seen: Callable[[int], bool], x: Callable[[int], float], reason: str, value: float
) -> None:
    decisions: list[Decision] = []
    recorder = Recorder((200, 100), decisions.append)
    tracker = Tracker(VisionSettings(), Crossings("cam", 200, 100), recorder)
    for k in range(14):
        left = 100.0 + x(k)
        blob = Blob(left, 50.0, left + 8.0, 70.0, left + 4.0, 100.0)
        tracker.step(k / FPS, [blob] if k < 7 and seen(k) else [])
    assert [(one.reason, one.value) for one in decisions] == [(reason, pytest.approx(value))]
    assert decisions[0].value < decisions[0].least


def test_what_ends_without_an_exit() -> None:
    # Lost behind a tree in mid-view for ever.
    into = Person(line(5.0, (-0.05, 0.7), (0.5, 0.75), 5.0))
    _, decisions, _ = analysed(Scene([into]), 30, VisionSettings(ignore=(TREE,)))
    assert reasons(of_objects(decisions)) == ["entered", "lost"]

    # On the other side it is another track, which continues it.
    through = Person(line(5.0, (-0.05, 0.7), (1.05, 0.75), 9.0))
    _, decisions, _ = analysed(Scene([through]), 20, VisionSettings(ignore=(TREE,)))
    decisions = of_objects(decisions)
    assert reasons(decisions) == ["entered", "continues", "left"]
    assert decisions[1].other == decisions[0].track == decisions[2].track
    assert decisions[1].value > 0.5

    # There from the start, and at the end.
    walks = Person(line(0.0, (0.2, 0.7), (0.7, 0.7), 12.0))
    _, decisions, _ = analysed(Scene([walks]), 11)
    assert "from start" in reasons(of_objects(decisions))
    assert reasons(of_objects(decisions))[-1] == "in view"


def test_pauses_and_changes_of_the_whole_picture() -> None:
    walks = Person(line(5.0, (-0.05, 0.7), (1.05, 0.7), 10.0))
    _, decisions, _ = analysed(Scene([walks]), 40, gap=9.0)
    assert reasons(of_objects(decisions)) == ["entered", "interrupted"]

    rng = np.random.default_rng(5)
    other = rng.integers(0, 255, (HEIGHT, WIDTH)).astype(np.uint8)
    scene, seen = Scene([walks]), list[Analysis]()
    pipeline = ViewPipeline("cam", VisionSettings(), seen.append)
    for k in range(round(20 * FPS)):
        t = k / FPS
        pipeline.process(t, scene.picture(t) if t < 9 else other)
    decisions = [one for each in seen for one in each.decisions]
    assert reasons(of_objects(decisions)) == ["entered", "scene changed"]
    assert any(analysis.moving is None for analysis in seen)
