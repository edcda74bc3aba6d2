"""What the grabber does quickly, against slow and obvious twins."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from camtopod.vision import background, blobs, kalman, shake, shrink, stature
from camtopod.vision.wiener import temporal_noise

Picture = npt.NDArray[np.uint8]
seeds = pytest.mark.parametrize("seed", range(6))


def picture(rng: np.random.Generator, height: int, width: int, coarse: int = 4) -> Picture:
    """Patches of all grey levels."""
    small = rng.integers(0, 256, (height // coarse + 1, width // coarse + 1)).astype(np.float32)
    large = cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
    result: Picture = np.clip(large + rng.normal(0, 3, large.shape), 0, 255).astype(np.uint8)
    return result


@pytest.mark.parametrize(
    ("height", "width"), [(1080, 1920), (720, 1280), (576, 768), (432, 768), (600, 800), (481, 643), (2160, 3840)]
)
def test_shrunk_is_the_mean_over_the_area(height: int, width: int) -> None:
    large = picture(np.random.default_rng(1), height, width, coarse=width // 40)
    small = shrink.shrunk(large, 320)
    assert small.shape == (round(height * 320 / width), 320)
    twin = cv2.resize(large, small.shape[::-1], interpolation=cv2.INTER_AREA)
    difference = np.abs(small.astype(int) - twin)
    assert difference.mean() < 1.0
    if width % 320 == 0 and height * 320 % width == 0:
        assert difference.max() <= 2  # rounded once a step


def test_what_is_small_enough_stays_but_elsewhere() -> None:
    small = picture(np.random.default_rng(1), 120, 160)
    same = shrink.shrunk(small, 320)
    np.testing.assert_array_equal(same, small)
    assert not np.shares_memory(same, small)


@seeds
def test_tone_curve(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = picture(rng, 180, 320)
    model = background.Background([scene], 20.0)
    frame = np.clip(scene * rng.uniform(0.6, 1.4) + rng.normal(0, 4, scene.shape), 0, 255).astype(np.uint8)
    settled = np.where(rng.uniform(size=scene.shape) < 0.8, np.uint8(255), np.uint8(0))
    change = frame[::4, ::4].astype(int) - scene[::4, ::4]
    centres, medians = [], []
    for low in range(0, 256, 16):
        here = (scene[::4, ::4] // 16 == low // 16) & (settled[::4, ::4] != 0)
        if here.sum() >= 24:
            centres.append(scene[::4, ::4][here].mean())
            medians.append(np.sort(change[here])[here.sum() // 2])
    twin = np.interp(np.arange(256), centres, medians)
    np.testing.assert_allclose(model._tone_shift(frame, settled), twin, atol=1e-4)
    assert not model._tone_shift(frame, np.zeros_like(scene)).any()


@seeds
def test_noise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = (picture(rng, 100, 140) for _ in range(2))
    change = np.sort(np.abs(a[::4, ::4].astype(int) - b[::4, ::4]).ravel())
    twin = change[: int(0.75 * len(change))].mean() / 0.5147 / np.sqrt(2)
    assert temporal_noise(a, b) == pytest.approx(twin, rel=1e-9)


@seeds
def test_shift(seed: int) -> None:
    rng = np.random.default_rng(seed)
    large = cv2.GaussianBlur(picture(rng, 200, 340, coarse=12), (0, 0), 2)
    x, y = int(rng.integers(-1, 2)), int(rng.integers(-1, 2))
    scene, frame = large[10:190, 10:330], large[10 + y : 190 + y, 10 + x : 330 + x]
    settled = np.where(rng.uniform(size=scene.shape) < 0.9, np.uint8(255), np.uint8(0))
    rows, columns = np.mgrid[1:179:4, 1:319]
    rows, columns = rows.ravel(), columns.ravel()
    s = scene.astype(float)
    off = s[rows, columns] - frame[rows, columns]
    dx = (s[rows, columns + 1] - s[rows, columns - 1]) / 2
    dy = (s[rows + 1, columns] - s[rows - 1, columns]) / 2
    good = (settled[rows, columns] != 0) & (np.abs(off) < 40)
    twin = np.linalg.lstsq(np.column_stack([dx, dy])[good], off[good])[0]
    assert shake.shift(frame, scene, settled) == pytest.approx(tuple(twin), abs=1e-3)


@seeds
def test_fragments(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mask = np.zeros((180, 320), np.uint8)
    part = mask[60:130, 41:200]
    part[:] = np.where(rng.uniform(size=part.shape) < 0.3 * seed / 5, np.uint8(255), np.uint8(0))
    labels, stats = blobs._fragments(mask)
    _, twin, twin_stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    assert sorted(map(tuple, stats[1:].tolist())) == sorted(map(tuple, twin_stats[1:].tolist()))
    np.testing.assert_array_equal(labels != 0, twin != 0)
    pairs = set(zip(labels.ravel().tolist(), twin.ravel().tolist(), strict=True))
    assert len(pairs) == len(twin_stats) == len(stats) or not mask.any()


def test_kalman_is_the_textbook_s() -> None:
    rng = np.random.default_rng(2)
    height, dt = 50.0, 0.16
    start = rng.uniform(0, 100, 4)
    quick = kalman.Kalman(tuple(start.tolist()), height)
    state = np.column_stack([start, np.zeros(4)])
    noise = (kalman.MEASUREMENT * height) ** 2
    covariance = np.diag([noise, (kalman.SPEED_AT_BIRTH * height) ** 2])
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


def test_stature_is_the_line_through_the_heights() -> None:
    learned = stature.Stature()
    rows = np.random.default_rng(3).uniform(50, 170, 40)
    for number, row in enumerate(rows):
        learned.add(number % 3, float(row), 20.0 + 0.3 * float(row))
    learned.add(9, 100.0, 300.0)  # no person
    for row in (60.0, 100.0, 160.0):
        assert learned.height(row) == pytest.approx(20.0 + 0.3 * row, abs=0.1)
