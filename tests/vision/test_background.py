"""The model of the scene under the light of a frame."""

from __future__ import annotations

import numpy as np
import pytest

from camtopod.vision.detect.background import Background

SCENE = np.random.default_rng(0).integers(40, 200, (120, 160)).astype(np.uint8)
MASK = np.full(SCENE.shape, 255, np.uint8)


@pytest.mark.parametrize(("noise", "shift", "followed"), [(0, 1, 0), (0, 5, 4), (8, 4, 0)])
def test_a_tone_that_noise_can_shift_is_not_followed(
    noise: float, shift: int, followed: int
) -> None:
    """Else pixels that are not learned would drift with it."""
    expected = Background([SCENE]).expected(SCENE + np.uint8(shift), MASK, noise)
    assert (expected == SCENE + np.uint8(followed)).all()
