"""Why a track became an event or not: reasons are handed out, and nothing depends on it."""

from __future__ import annotations

from collections import Counter
from typing import get_args

import pytest
from rendered_scenes import FPS, Person, Scene, line

from camtopod.records import Event
from camtopod.vision.pipeline import Analysis, ViewPipeline
from camtopod.vision.settings import Polygon, VisionSettings
from camtopod.vision.track import Decision
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
    scene: Scene, seconds: float, settings: VisionSettings | None = None
) -> tuple[list[Event], list[Decision], set[int]]:
    """Return events, decisions, and the numbers of all tracks."""
    decisions: list[Decision] = []
    numbers: set[int] = set()

    def observe(seen: Analysis) -> None:
        decisions.extend(seen.decisions)
        numbers.update(track.number for track in seen.tracks)

    pipeline, events = ViewPipeline("cam", settings or VisionSettings(), observe), []
    for k in range(round(seconds * FPS)):
        events += pipeline.process(k / FPS, scene.picture(k / FPS))
    return events + pipeline.finish(), decisions, numbers


def of_objects(decisions: list[Decision]) -> list[Decision]:
    """Return the decisions about objects, without those about fragments that never became one."""
    return [decision for decision in decisions if decision.reason not in get_args(Shortfall)]


def reasons(decisions: list[Decision]) -> list[str]:
    return [decision.reason for decision in decisions]


def test_every_track_ends_once_and_every_event_has_its_decision() -> None:
    events, decisions, numbers = analysed(Scene(CROWD), 20)
    assert events == Scene(CROWD).events(20), "the events do not depend on who observes"

    ends = {*get_args(Shortfall), *get_args(Ending)}
    ended = Counter(one.track for one in decisions if one.reason in ends)
    assert set(ended) >= numbers
    assert set(ended.values()) == {1}
    said = [one for one in decisions if one.reason in ("entered", "left")]
    assert [(str(one.track), round(one.t, 6)) for one in said] == [(e.track, e.t) for e in events]
    assert [one.place for one in said] == [
        (pytest.approx(e.x, abs=1e-4), pytest.approx(e.y, abs=1e-4)) for e in events
    ]
    assert not {*get_args(Beginning)} & ends


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


def test_what_ends_without_an_exit() -> None:
    # Lost behind a tree in mid-view for ever.
    into = Person(line(5.0, (-0.05, 0.7), (0.5, 0.75), 5.0))
    _, decisions, _ = analysed(Scene([into]), 30, VisionSettings(ignore=(TREE,)))
    assert reasons(of_objects(decisions)) == ["entered", "lost"]

    # On the other side it is another track, without an entry.
    through = Person(line(5.0, (-0.05, 0.7), (1.05, 0.75), 9.0))
    _, decisions, _ = analysed(Scene([through]), 20, VisionSettings(ignore=(TREE,)))
    assert sorted(reasons(of_objects(decisions))) == ["entered", "in mid-view", "left", "lost"]

    # There from the start, and at the end.
    walks = Person(line(0.0, (0.2, 0.7), (0.7, 0.7), 12.0))
    _, decisions, _ = analysed(Scene([walks]), 11)
    assert "from start" in reasons(of_objects(decisions))
    assert reasons(of_objects(decisions))[-1] == "in view"
