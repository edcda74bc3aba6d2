"""Fast parts of the grabber against slow and obvious versions."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from camtopod.vision.detect import shake, shrink
from camtopod.vision.track import kalman

Picture = npt.NDArray[np.uint8]


def picture(rng: np.random.Generator, height: int, width: int, coarse: int = 4) -> Picture:
    """Return patches of all grey levels."""
    small = rng.integers(0, 256, (height // coarse + 1, width // coarse + 1)).astype(np.float32)
    large = cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
    result: Picture = np.clip(large + rng.normal(0, 3, large.shape), 0, 255).astype(np.uint8)
    return result


@pytest.mark.parametrize(("height", "width"), [(1080, 1920), (576, 768), (481, 643)])
def test_shrunk_is_the_mean_over_the_area(height: int, width: int) -> None:
    large = picture(np.random.default_rng(1), height, width, coarse=width // 40)
    small = shrink.shrunk(large, 320)

    assert small.shape == (round(height * 320 / width), 320)
    twin = cv2.resize(large, small.shape[::-1], interpolation=cv2.INTER_AREA)
    difference = np.abs(small.astype(int) - twin)
    assert difference.mean() < 1.0
    if width % 320 == 0 and height * 320 % width == 0:
        assert difference.max() <= 2  # rounded once a step


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (3.0, -2.0), (-6.0, 5.0)])
def test_a_picture_is_moved_back(x: float, y: float) -> None:
    large = cv2.GaussianBlur(picture(np.random.default_rng(3), 240, 380, coarse=12), (0, 0), 2)
    left, top = 30 + int(x), 30 + int(y)
    scene, frame = large[30:210, 30:350], large[top : top + 180, left : left + 320]
    settled = np.full(scene.shape, 255, np.uint8)
    back = shake.shifted_back(frame, scene, settled, shake.shift(frame, scene, settled))
    inner = (slice(8, -8), slice(8, -8))

    assert np.abs(back[inner].astype(int) - scene[inner]).mean() < 0.5


def test_kalman_is_the_textbook_s() -> None:
    rng = np.random.default_rng(2)
    height, dt = 50.0, 0.16
    start = rng.uniform(0, 100, 4)
    quick = kalman.Kalman(tuple(start.tolist()), height)
    state = np.column_stack([start, np.zeros(4)])
    noise = (kalman.MEASUREMENT * height) ** 2
    covariance = np.diag([noise, (kalman.SPEED_SIGMA * height) ** 2])
    step = np.array([[1.0, dt], [0.0, 1.0]])
    push = np.array([dt * dt / 2, dt]) * kalman.ACCELERATION * height
    for _ in range(20):
        measured = rng.uniform(0, 100, 4)
        quick.predict(dt, height, coasting=False)
        state, covariance = state @ step.T, step @ covariance @ step.T + np.outer(push, push)
        np.testing.assert_allclose(quick.position, state[:, 0], rtol=1e-9)
        quick.update(tuple(measured.tolist()), height)
        gain = covariance[:, 0] / (covariance[0, 0] + noise)
        state = state + np.outer(measured - state[:, 0], gain)
        covariance = covariance - np.outer(gain, covariance[0])
        np.testing.assert_allclose(quick.position, state[:, 0], rtol=1e-9)
        np.testing.assert_allclose(quick.velocity, state[:, 1], rtol=1e-9)
        assert quick.uncertainty == pytest.approx(np.sqrt(covariance[0, 0]))
