"""Whatever its state is disturbed by, a view counts people again after 10 s of pictures that fit."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt
from hypothesis import given, settings, strategies as st
from rendered_scenes import FPS, HEIGHT, WIDTH, Person, Picture, Scene, line

from camtopod.records import Event
from camtopod.vision.detect import MotionDetector, shake
from camtopod.vision.detect.motion import SHAKE_PIXELS
from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import VisionSettings

DISTURBED_AT = 5.0
"""Time of the disturbance, seconds: there is a background, and nobody is in view."""
AGAIN = DISTURBED_AT + 10.0
"""Time from which people are counted again, seconds."""
SCENE = Scene(
    [
        Person(line(AGAIN + 0.5, (-0.05, 0.7), (1.05, 0.6), 6.0), seed=1),
        Person(line(AGAIN + 2.5, (1.05, 0.85), (-0.05, 0.9), 6.0), shade=220, seed=2),
    ]
)


@cache
def pictures() -> list[Picture]:
    """Return the pictures of `SCENE`, the same in each example."""
    return [SCENE.picture(k / FPS) for k in range(round((AGAIN + 10.0) * FPS))]


def recovers(disturb: Callable[[MotionDetector], None]) -> None:
    """Check that both people are counted, and nobody else, after a disturbance."""
    pipeline = ViewPipeline("cam", VisionSettings())
    events: list[Event] = []
    for k, picture in enumerate(pictures()):
        if k == round(DISTURBED_AT * FPS):
            disturb(pipeline._motion)
        events += pipeline.process(k / FPS, picture)
    later = [event for event in events + pipeline.finish() if event.t >= AGAIN]
    later.sort(key=lambda event: event.t)
    sides = ["left" if (event.x or 0.0) < 0.5 else "right" for event in later]
    assert [event.kind for event in later] == ["entry", "entry", "exit", "exit"]
    assert sides == ["left", "right", "right", "left"]


def replace_background(motion: MotionDetector, picture: npt.NDArray[np.floating]) -> None:
    """Make ``picture`` the settled scene of a detector."""
    image = picture.clip(0, 255).astype(np.uint8)
    motion._background._model = image.astype(np.float32)
    motion._background.image = image


def patches(cell: int, level: float, contrast: float, seed: int) -> npt.NDArray[np.float32]:
    """Return a picture of smooth patches of ``cell`` pixels, grey levels level +- contrast."""
    size = (HEIGHT // cell + 2, WIDTH // cell + 2)
    levels = level + np.random.default_rng(seed).uniform(-contrast, contrast, size)
    picture = cv2.resize(levels, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    return np.asarray(picture, np.float32)


SHAKES = st.one_of(st.floats(0.0, 10.0), st.floats(10.0, 1e4))
"""Pixels. The running mean falls to the ten thousandth in 90 pictures, 13 s."""


def maps(shift: float, linear: float) -> st.SearchStrategy[shake.Map]:
    """Return maps up to a shift (half widths) and a deviation from the identity's linear part."""
    shifts, changes = st.floats(-shift, shift), st.floats(-linear, linear)
    rows = st.tuples(*[st.tuples(changes, changes, shifts)] * 2)
    return rows.map(lambda off: np.vstack([off, np.zeros((1, 3))]) + shake.IDENTITY)


# Derandomised: which blobs are fragments of a person, and which are not, hangs by a pixel.


@given(by=st.one_of(maps(0.2, 0.1), maps(0.5, 0.3), maps(4.0, 2.0)), pixels=SHAKES)
@settings(max_examples=8)
def test_any_alignment_map(by: shake.Map, pixels: float) -> None:
    """It is used if the camera seems to shake."""

    def disturb(motion: MotionDetector) -> None:
        motion._map, motion.shake = by, pixels

    recovers(disturb)


@given(pixels=SHAKES)
@settings(max_examples=4)
def test_any_shake(pixels: float) -> None:
    recovers(lambda motion: setattr(motion, "shake", pixels))


@given(noise=st.floats(0.0, 128.0))
@settings(max_examples=4)
def test_any_noise(noise: float) -> None:
    recovers(lambda motion: setattr(motion, "noise", noise))


@given(difference=st.integers(0, 255), count=st.floats(1.0, 1e6))
@settings(max_examples=5)
def test_any_contrast_of_objects(difference: int, count: float) -> None:
    """Up to what objects that fill the picture are counted as."""

    def disturb(motion: MotionDetector) -> None:
        motion._object_contrast._counts[difference] = count

    recovers(disturb)


@given(tone=st.floats(-60.0, 60.0))
@settings(max_examples=5)
def test_a_background_in_another_tone(tone: float) -> None:
    recovers(lambda motion: replace_background(motion, motion._background.image + tone))


@given(
    cell=st.sampled_from([4, 8, 16, 32, 64]),
    level=st.floats(20.0, 235.0),
    contrast=st.floats(0.0, 120.0),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=8)
def test_another_background(cell: int, level: float, contrast: float, seed: int) -> None:
    recovers(lambda motion: replace_background(motion, patches(cell, level, contrast, seed)))


def test_nothing_settled() -> None:
    recovers(lambda motion: motion._settled_mask.fill(0))


def test_a_camera_that_stands_is_not_aligned_for_ever() -> None:
    """A scene of little contrast, whose background was that of another: half a minute later."""
    scene = Scene([])
    scene._floor = patches(24, 125.0, 15.0, seed=7)
    pipeline = ViewPipeline("cam", VisionSettings())
    for k in range(round((DISTURBED_AT + 30.0) * FPS)):
        if k == round(DISTURBED_AT * FPS):
            replace_background(pipeline._motion, patches(64, 70.6, 20.0, seed=592))
        pipeline.process(k / FPS, scene.picture(k / FPS))
    assert pipeline._motion.shake <= SHAKE_PIXELS
    assert pipeline._motion.view == (0.0, 0.0, WIDTH, HEIGHT)
