"""Settings of one camera: ignored areas, named doors, least height, sensitivity."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from rendered_scenes import FPS, HEIGHT, WIDTH, Person, Picture, Place, Scene, line

from camtopod.records import Event
from camtopod.vision.detect.motion import watched_pixels
from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import Polygon, VisionSettings


def rectangle(left: float, top: float, right: float, bottom: float) -> Polygon:
    return ((left, top), (right, top), (right, bottom), (left, bottom))


TREE = rectangle(0.35, 0.2, 0.65, 0.95)
STREET = rectangle(0.0, 0.0, 1.0, 0.25)


def leaves(area: Polygon) -> Callable[[Picture], None]:
    """Return a drawing of an area whose pixels change all the time."""
    rng = np.random.default_rng(7)
    inside = watched_pixels([area], HEIGHT, WIDTH) == 0

    def draw(picture: Picture) -> None:
        picture[inside] = rng.uniform(0, 255, int(inside.sum()))

    return draw


def watched(
    scene: Scene, seconds: float, settings: VisionSettings
) -> tuple[list[Event], ViewPipeline]:
    pipeline, events = ViewPipeline("cam", settings), []
    for k in range(round(seconds * FPS)):
        events += pipeline.process(k / FPS, scene.picture(k / FPS))
    return events + pipeline.finish(), pipeline


# --- ignored areas --------------------------------------------------------------------------------


def test_what_happens_in_an_ignored_area_changes_nothing() -> None:
    """Neither the events nor the estimates of noise, light and shake."""
    tree = rectangle(0.0, 0.0, 0.6, 0.4)
    walker = Person(line(5.0, (-0.05, 0.9), (1.05, 0.9), 8.0))
    light = {"light": lambda t: 1.0 if t < 9 else 0.8}
    settings = VisionSettings(ignore=(tree,))
    quiet, pipeline = watched(Scene([walker], **light), 18, settings)
    busy, other = watched(Scene([walker], front=leaves(tree), **light), 18, settings)

    assert [event.kind for event in quiet] == ["entry", "exit"]
    assert busy == quiet
    assert other.statistics() == pipeline.statistics()


@pytest.mark.parametrize(("sense", "seconds"), [(-1, 9.0), (1, 20.0)])
def test_who_walks_through_an_ignored_area_enters_and_leaves_once(
    sense: int, seconds: float
) -> None:
    ends = ((-0.05, 0.7), (1.05, 0.75))[::sense]
    scene = Scene([Person(line(5.0, *ends, seconds))])
    events = scene.events(11 + seconds, VisionSettings(ignore=(TREE,)))
    assert [event.kind for event in events] == ["entry", "exit"]


@pytest.mark.parametrize(
    ("area", "a", "b"),
    [
        (STREET, (0.5, 0.15), (0.4, 1.25)),
        (rectangle(0.0, 0.0, 0.2, 1.0), (-0.05, 0.7), (1.05, 0.7)),
    ],
)
def test_where_an_ignored_area_reaches_the_border_its_edge_is_an_edge_of_the_view(
    area: Polygon, a: Place, b: Place
) -> None:
    for ends, first in (((a, b), 0), ((b, a), 1)):
        events = Scene([Person(line(5.0, *ends, 8.0))]).events(18, VisionSettings(ignore=(area,)))
        assert [event.kind for event in events] == ["entry", "exit"]
        assert events[0].track == events[1].track
        at = events[first]
        near = [(max(0.0, x - 0.12), max(0.0, y - 0.12)) for x, y in area]
        far = [(x + 0.12, y + 0.12) for x, y in area]
        assert min(x for x, _ in near) <= (at.x or 0) <= max(x for x, _ in far)
        assert min(y for _, y in near) <= (at.y or 0) <= max(y for _, y in far)


# --- doors ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("door", [((0.5, 0.55),), rectangle(0.4, 0.45, 0.6, 0.65)])
def test_a_named_door_counts_from_the_first_time_on(door: Polygon) -> None:
    out = Person(line(6.0, (0.5, 0.55), (-0.05, 0.75), 6.0))
    back = Person(line(16.0, (-0.05, 0.75), (0.5, 0.55), 6.0), seed=2)
    scene = Scene([out, back])

    assert [event.kind for event in scene.events(34)] == ["exit", "entry"]
    events = scene.events(34, VisionSettings(doors=(door,)))
    assert [event.kind for event in events] == ["entry", "exit", "entry", "exit"]
    inside = [events[0], events[3]]
    assert all((event.x or 0) == pytest.approx(0.5, abs=0.08) for event in inside)


# --- height and sensitivity -----------------------------------------------------------------------


def test_what_is_lower_than_the_least_height_makes_no_events() -> None:
    cat = Person(line(5.0, (-0.05, 0.8), (1.05, 0.8), 8.0), tall=0.1)
    man = Person(line(8.0, (1.05, 0.5), (-0.05, 0.5), 8.0), tall=0.25, seed=1)
    scene = Scene([cat, man])

    assert len(scene.events(20)) == 4
    events = scene.events(20, VisionSettings(min_height=0.18))
    assert [event.kind for event in events] == ["entry", "exit"]
    assert events[0].t == pytest.approx(8.2, abs=0.5), "the time of the first sighting"
    assert scene.events(20, VisionSettings(min_height=0.5)) == []


def test_a_faint_person_needs_more_of_it() -> None:
    walker = Person(line(5.0, (-0.05, 0.7), (1.05, 0.7), 8.0), tall=0.3, shade=20)
    seen = Scene([walker], noise=0.5)
    empty, found = Scene([], noise=0.5), {}
    for sensitivity in (0.5, 1.0, 3.0):
        pipeline, events = ViewPipeline("cam", VisionSettings(sensitivity=sensitivity)), []
        for k in range(round(16 * FPS)):
            picture = 0.7 * empty.picture(k / FPS) + 0.3 * seen.picture(k / FPS)
            events += pipeline.process(k / FPS, picture.astype(np.uint8))
        found[sensitivity] = [event.kind for event in events + pipeline.finish()]

    assert found == {0.5: [], 1.0: [], 3.0: ["entry", "exit"]}
