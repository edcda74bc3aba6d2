"""The Wiener filter equals its slow version; the noise estimate finds the noise that was added."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings, strategies as st

from camtopod.vision.detect.wiener import temporal_noise, wiener


@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    size=st.sampled_from([3, 5, 7]),
    noise=st.floats(0.5, 500.0),
)
@settings(max_examples=30, deadline=None)
def test_equals_scipy(seed: int, shape: tuple[int, int], size: int, noise: float) -> None:
    image = np.random.default_rng(seed).uniform(0, 255, shape)
    np.testing.assert_allclose(
        wiener(image, size, noise), scipy.signal.wiener(image, size, noise), rtol=1e-9, atol=1e-7
    )


@pytest.mark.parametrize("sigma", [2.0, 10.0])
def test_noise_is_measured_whatever_the_texture_and_some_motion(sigma: float) -> None:
    rng = np.random.default_rng(3)
    scene = rng.uniform(40, 200, (240, 320))
    a, b = (
        np.clip(scene + rng.normal(0, sigma, scene.shape), 0, 255).astype(np.uint8)
        for _ in range(2)
    )
    b[50:150, 100:160] = 20  # somebody came

    assert temporal_noise(b, a, np.full(b.shape, 255, np.uint8)) == pytest.approx(sigma, rel=0.2)
