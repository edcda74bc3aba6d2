"""Scenery that sways is no object, and hides nobody who walks past it."""

from __future__ import annotations

import pytest
from rendered_scenes import FPS, Person, Scene, line

from bench.support.clip_variants import Bush
from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import VisionSettings

SECONDS = 60.0


def windy(people: list[Person]) -> list[tuple[str, float]]:
    """Return kind and time of the events of a scene with a bush at its left border."""
    scene, pipeline = Scene(people), ViewPipeline("cam", VisionSettings())
    bush = Bush(60, 60, gust=2.0)
    events = []
    for k in range(round(SECONDS * FPS)):
        picture = scene.picture(k / FPS)
        bush.draw(picture[20:80, :60], k / FPS)
        events += pipeline.process(k / FPS, picture)
    return [(event.kind, event.t) for event in events + pipeline.finish()]


def test_nobody_enters_out_of_a_bush_in_the_wind() -> None:
    assert windy([]) == []


def test_who_walks_past_it_is_seen() -> None:
    walker = Person(line(30.0, (-0.05, 0.85), (1.05, 0.85), 8.0), shade=20)
    (entry, entered), (leaving, left) = windy([walker])
    assert (entry, leaving) == ("entry", "exit")
    assert entered == pytest.approx(30.3, abs=0.7)
    assert left == pytest.approx(37.7, abs=0.7)
