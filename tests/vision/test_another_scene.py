"""What is known of a scene, heights and doors, survives another light, but no turn of the camera."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from rendered_scenes import FPS, HEIGHT, WIDTH, Picture, Scene

from camtopod.vision.detect.background import is_other, view_image
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


def kept(pictures: Callable[[int], Picture], seconds: float = 14.0, relearned: int = 1) -> bool:
    """Return True if the heights and a door that are known at 5 s are known at the end.

    relearned: how often the scene was learned anew until then.
    """
    pipeline = ViewPipeline("cam", VisionSettings())
    for k in range(round(seconds * FPS)):
        pipeline.process(k / FPS, np.clip(pictures(k), 0, 255).astype(np.uint8))
        if k == round(5 * FPS):
            tracker = pipeline._tracker
            assert tracker is not None
            for sample in range(30):
                tracker.stature.add(sample % 3, 100.0, 30.0)
            for _ in range(3):
                tracker.crossings.doors.record_unexplained((90.0, 100.0))
    assert pipeline.statistics()["relearned"] == relearned
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


def test_what_is_known_of_a_scene_is_not_that_beside_it() -> None:
    """A camera that was turned by a quarter of its view shows much of the earlier one."""
    scene = Scene([])

    def pictures(k: int) -> Picture:
        picture = scene.picture(k / FPS)
        return picture if k < 6 * FPS else np.roll(picture, WIDTH // 4, axis=1)

    assert not kept(pictures)


def test_what_is_known_of_a_scene_is_known_after_a_sheet_before_the_lens() -> None:
    scene = Scene([])

    def pictures(k: int) -> Picture:
        picture = scene.picture(k / FPS)
        return picture * 0 + 200 if 6 * FPS < k < 13 * FPS else picture

    assert kept(pictures, seconds=24.0, relearned=2)


def test_a_round_picture_does_not_make_views_alike() -> None:
    columns, rows = np.meshgrid(np.linspace(-1.3, 1.3, WIDTH), np.linspace(-1.0, 1.0, HEIGHT))
    circle = np.where(np.hypot(columns, rows) < 1.0, 255, 0).astype(np.uint8)
    picture = Scene([]).picture(0.0)
    upright, upside_down = (
        view_image(np.where(circle > 0, image, np.uint8(0)), circle)
        for image in (picture, turned(picture))
    )
    assert upright is not None
    assert upside_down is not None
    assert is_other(upside_down, upright)


@pytest.mark.parametrize("light", LIGHTS)
def test_a_scene_is_the_same_in_any_light(light: str) -> None:
    scene = Scene([])
    earlier, picture = scene.picture(0.0), scene.picture(1.0)
    later = np.clip(LIGHTS[light](picture), 0, 255).astype(np.uint8)
    mask = np.full_like(later, 255)
    if (later_view := view_image(later, mask)) is None:
        assert light == "none"
        return
    assert not is_other(later_view, earlier)
    assert not is_other(earlier, later_view)
    assert is_other(np.ascontiguousarray(turned(picture)), earlier)
