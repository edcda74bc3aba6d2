"""Fast parts of the grabber against slow and obvious versions."""

from __future__ import annotations

import numpy as np
import pytest

from camtopod.vision.track import kalman


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
        quick.predict(dt, height)
        state, covariance = state @ step.T, step @ covariance @ step.T + np.outer(push, push)
        np.testing.assert_allclose(quick.position, state[:, 0], rtol=1e-9)
        quick.update(tuple(measured.tolist()), height)
        gain = covariance[:, 0] / (covariance[0, 0] + noise)
        state = state + np.outer(measured - state[:, 0], gain)
        covariance = covariance - np.outer(gain, covariance[0])
        np.testing.assert_allclose(quick.position, state[:, 0], rtol=1e-9)
        np.testing.assert_allclose(quick.velocity, state[:, 1], rtol=1e-9)
        assert quick.uncertainty == pytest.approx(np.sqrt(covariance[0, 0]))
