"""A camera that sways: which maps align its images, what they show, and what moves in them."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from rendered_scenes import FPS, HEIGHT, WIDTH, Picture

from camtopod.vision.boxes import Box, area, pixels
from camtopod.vision.detect import MotionDetector, shake
from camtopod.vision.detect.motion import SHAKE_PIXELS, Motion
from camtopod.vision.settings import VisionSettings

HALF = WIDTH / 2
"""Pixels of a shift of 1 in a map."""
EVERYWHERE = np.full((HEIGHT, WIDTH), 255, np.uint8)
WHOLE: Box = (0.0, 0.0, float(WIDTH), float(HEIGHT))


def patches(cell: int, contrast: float = 65.0) -> Picture:
    """Return a scene of smooth patches of ``cell`` pixels, grey levels 125 +- ``contrast``."""
    size = (HEIGHT // cell + 2, WIDTH // cell + 2)
    levels = np.random.default_rng(1).uniform(-contrast, contrast, size)
    scene = 125.0 + cv2.resize(levels, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    return scene.clip(0, 255).astype(np.uint8)


def map_of(x: float = 0.0, y: float = 0.0, zoom: float = 1.0, turn: float = 0.0) -> shake.Map:
    """Return the map of a shift (pixels), a zoom and a turn (radians) about the middle."""
    by = shake.IDENTITY.copy()
    by[:2, :2] = zoom * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    by[:2, 2] = x / HALF, y / HALF
    return by


def seen_by(scene: Picture, by: shake.Map) -> Picture:
    """Return the image of ``scene`` for a map from the scene to the image."""
    height, width = scene.shape
    middle = np.array([width - 1, height - 1]) / 2
    matrix = by[:2].copy()
    matrix[:, 2] = by[:2, 2] * HALF + middle - by[:2, :2] @ middle
    image = cv2.warpAffine(scene, matrix, (width, height), borderMode=cv2.BORDER_REFLECT)
    return np.asarray(image, np.uint8)


def assert_same(by: shake.Map, expected: shake.Map) -> None:
    """Check that two maps agree to a part of a pixel everywhere in the image."""
    assert np.abs(HALF * (by - expected)).max() < 0.3, HALF * by[:2]


# --- maps that are used ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    "by",
    [map_of(3.4, -2.6), map_of(-6.0, 3.5), map_of(zoom=1.06), map_of(2.0, 1.0, turn=0.05)],
    ids=["sway", "far", "zoom", "turn"],
)
@pytest.mark.parametrize("cell", [8, 24])
def test_a_camera_that_sways_is_aligned(cell: int, by: shake.Map) -> None:
    scene = patches(cell)
    image = seen_by(scene, by)
    image[60:120, 80:104] = 20  # somebody stands there

    assert_same(shake.aligning(image, scene, EVERYWHERE, shake.IDENTITY), by)


def test_a_drift_is_followed_as_far_as_cameras_sway() -> None:
    scene, by = patches(8), shake.IDENTITY
    for k in range(46):
        drift = map_of(0.4 * k, -0.1 * k)
        by = shake.aligning(seen_by(scene, drift), scene, EVERYWHERE, by)
        assert_same(by, drift)


@pytest.mark.parametrize(
    "first",
    [map_of(2.5 * HALF), map_of(0.0, 30.0), map_of(zoom=0.5), map_of(zoom=1.2)],
    ids=["out of view", "far down", "half", "larger"],
)
def test_alignment_does_not_begin_far_off(first: shake.Map) -> None:
    """Neither an image that stands nor one that sways is aligned from there."""
    scene, sway = patches(8), map_of(3.0, -2.0)
    for by in (shake.IDENTITY, sway):
        image = seen_by(scene, by)
        assert_same(shake.aligning(image, scene, EVERYWHERE, first), by)


@pytest.mark.parametrize(
    "by",
    [map_of(25.0), map_of(0.0, -24.0), map_of(-30.0), map_of(zoom=1.25), map_of(zoom=0.85)],
    ids=["right", "up", "left", "larger", "smaller"],
)
def test_a_map_farther_than_cameras_sway_is_none(by: shake.Map) -> None:
    """Each of these would be found without bounds, because the scene is smooth."""
    scene = patches(48)
    assert_same(
        shake.aligning(seen_by(scene, by), scene, EVERYWHERE, shake.IDENTITY), shake.IDENTITY
    )


@pytest.mark.parametrize(
    ("scene", "size", "shade"),
    [
        (patches(24, 5.0), (100, 60), 125),
        (patches(24, 15.0), (150, 100), 100),
        (patches(48, 15.0), (100, 60), 90),
    ],
    ids=["of the road's grey", "near", "dark"],
)
def test_a_car_that_drives_past_is_no_sway(
    scene: Picture, size: tuple[int, int], shade: int
) -> None:
    rng = np.random.default_rng(3)
    paint = shade + rng.integers(-25, 26, (4, 8)).astype(np.float32)
    car = cv2.resize(paint, size, interpolation=cv2.INTER_NEAREST)
    by = shake.IDENTITY
    for left in range(-size[0], WIDTH, 16):
        image = scene + rng.normal(0, 1.0, scene.shape)
        shown = slice(max(0, left), min(WIDTH, left + size[0]))
        image[30 : 30 + size[1], shown] = car[:, shown.start - left : shown.stop - left]
        by = shake.aligning(image.round().astype(np.uint8), scene, EVERYWHERE, by)
        assert (by == shake.IDENTITY).all(), left


# --- what an image shows --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("by", "expected"),
    [
        (map_of(), WHOLE),
        (map_of(x=12), (0, 0, WIDTH - 12, HEIGHT)),
        (map_of(x=-12), (12, 0, WIDTH, HEIGHT)),
        (map_of(y=7), (0, 0, WIDTH, HEIGHT - 7)),
        (map_of(y=-7), (0, 7, WIDTH, HEIGHT)),
        (map_of(5, -9), (0, 9, WIDTH - 5, HEIGHT)),
        (map_of(zoom=1.1), (9, 7, WIDTH - 9, HEIGHT - 7)),
        (map_of(zoom=0.9), WHOLE),
    ],
)
def test_a_shifted_image_shows_a_part_of_the_scene(by: shake.Map, expected: Box) -> None:
    assert shake.view(patches(8), by) == pytest.approx(expected, abs=1.0)


def test_rows_and_columns_count_that_are_shown_by_half() -> None:
    """Half of the first and last ones are turned out of view: some of twelve rows are in part."""
    for turn in (0.06, -0.06):
        assert shake.view(patches(8), map_of(turn=turn)) == pytest.approx(WHOLE, abs=1.0)
        left, *_, bottom = shake.view(patches(8), map_of(-10, 6, turn=turn))
        assert (left, bottom) == pytest.approx((10, HEIGHT - 6), abs=1.0)


# --- what moves in it -----------------------------------------------------------------------------


def tiles() -> Picture:
    """Return a scene of tiles whose edges have the highest contrast."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    dark = (x // 16 + y // 12) % 2 == 0
    return np.where(dark, 20, 235).astype(np.uint8) // 2 + patches(24) // 2


def trembling(motion: MotionDetector, someone: Box | None = None) -> Iterator[Motion]:
    """Yield the motion in images that tremble by up to 1.5 pixels, after a first background.

    someone: the box of somebody who comes after it, if anybody does.
    """
    scene, rng = tiles(), np.random.default_rng(6)
    frames = []
    for k in range(60):
        image = scene.copy()
        if someone is not None and k >= 30:
            left, top, right, bottom = map(int, someone)
            image[top:bottom, left:right] = 10 + 30 * (np.arange(right - left) // 6 % 2)
        frame = motion.filter_noise(seen_by(image, map_of(*rng.uniform(-1.5, 1.5, 2))))
        if k < 20:
            frames.append(frame)
            continue
        if k == 20:
            motion.bootstrap(frames)
        found = motion.detect(frame, 1 / FPS)
        assert found is not None
        if k >= 30:
            assert motion.shake > SHAKE_PIXELS
            yield found


def test_nothing_moves_at_the_edges_of_a_scene_that_trembles() -> None:
    for found in trembling(MotionDetector(VisionSettings())):
        assert not found.moving_mask.any()


def test_who_comes_into_a_scene_that_trembles_moves() -> None:
    someone = (85.0, 45.0, 109.0, 105.0)
    rows, columns = pixels(someone, (HEIGHT, WIDTH))
    for found in trembling(MotionDetector(VisionSettings()), someone):
        part = np.count_nonzero(found.moving_mask[rows, columns])
        assert part > 0.6 * area(someone)
        assert np.count_nonzero(found.moving_mask) - part < 0.1 * area(someone)


def detector_of(scene: Picture) -> MotionDetector:
    """Return a detector that knows a scene and has seen no shake."""
    motion = MotionDetector(VisionSettings())
    motion.bootstrap([motion.filter_noise(scene)] * 5)
    assert motion.shake == 0.0
    return motion


def test_edges_of_a_camera_that_stands_are_exact() -> None:
    """The same part of a pixel is motion there."""
    motion = detector_of(tiles())
    found = motion.detect(seen_by(tiles(), map_of(0.6, 0.0)), 1 / FPS)
    assert found is not None
    assert found.change_mask.any()


def test_the_view_is_what_the_image_shows_while_the_camera_shakes() -> None:
    """A shake that has ended leaves its last map behind, which no image is aligned by."""
    scene, sway = patches(8), map_of(6.0, -4.0)
    motion = detector_of(scene)
    motion.shake = 1.0
    for image, expected in (
        (seen_by(scene, sway), (0, 4, WIDTH - 6, HEIGHT)),
        (scene, WHOLE),
        (seen_by(scene, sway), (0, 4, WIDTH - 6, HEIGHT)),
    ):
        assert motion.detect(image, 1 / FPS) is not None
        assert motion.view == pytest.approx(expected, abs=1.0)
    motion.shake = 0.0
    assert motion.detect(scene, 1 / FPS) is not None
    assert motion.view == WHOLE
