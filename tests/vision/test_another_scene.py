"""What is known of a scene, heights and doors, survives another light, but no turn of the camera."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from rendered_scenes import FPS, WIDTH, Picture, Scene

from camtopod.vision.detect.background import is_other
from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import VisionSettings

COLUMNS = np.linspace(0.3, 1.5, WIDTH)
LIGHTS: dict[str, Callable[[Picture], Picture]] = {
    "little": lambda picture: picture * 0.25,
    "a lamp at one side": lambda picture: picture * COLUMNS,
    "too much": lambda picture: picture * 1.8,
    "none": lambda picture: picture * 0.0,
}


def turned(picture: Picture) -> Picture:
    return picture[::-1, ::-1]


def kept(pictures: Callable[[int], Picture]) -> bool:
    """Return True if the heights and a door that are known at 5 s are known at the end."""
    pipeline = ViewPipeline("cam", VisionSettings())
    for k in range(round(14 * FPS)):
        pipeline.process(k / FPS, np.clip(pictures(k), 0, 255).astype(np.uint8))
        if k == round(5 * FPS):
            tracker = pipeline._tracker
            assert tracker is not None
            for sample in range(30):
                tracker.stature.add(sample % 3, 100.0, 30.0)
            for _ in range(3):
                tracker.crossings.doors.record_unexplained((90.0, 100.0))
    assert pipeline.statistics()["relearned"] == 1
    tracker = pipeline._tracker
    assert tracker is not None
    door = tracker.crossings.doors.door_at(90.0, 100.0, 30.0)
    assert (tracker.stature.height(100.0) is None) == (door is None)
    return door is not None


def test_what_is_known_of_a_scene_is_not_that_of_another() -> None:
    scene = Scene([])

    def pictures(k: int) -> Picture:
        picture = scene.picture(k / FPS)
        return picture if k < 6 * FPS else turned(picture)

    assert not kept(pictures)


def test_what_is_known_of_a_scene_is_known_when_lamps_go_on() -> None:
    """They shine from two sides, which no curve of grey levels makes good."""
    scene = Scene([])
    half = np.where(np.arange(WIDTH) < WIDTH / 2, 0.4, 1.3)

    def pictures(k: int) -> Picture:
        picture = scene.picture(k / FPS)
        return picture * half if k < 6 * FPS else picture * half[::-1]

    assert kept(pictures)


@pytest.mark.parametrize("light", LIGHTS)
def test_a_scene_is_the_same_in_any_light(light: str) -> None:
    scene = Scene([])
    earlier, picture = scene.picture(0.0), scene.picture(1.0)
    later = np.clip(LIGHTS[light](picture), 0, 255).astype(np.uint8)
    assert not is_other(later, earlier)
    assert not is_other(earlier, later)
    assert is_other(np.ascontiguousarray(turned(picture)), earlier)
