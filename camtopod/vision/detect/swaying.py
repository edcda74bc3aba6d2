"""Dynamic background: scenery that sways, such as branches, flags and reflections on water.

A pixel of such scenery alternates between background and foreground although no object passes.
Where it does so often, it counts as foreground only if it is brighter or darker than all pixels of
the scene in its neighbourhood. People in front of moving leaves are therefore detected only in
part; without this rule, the leaves would be detected as objects.
"""

from __future__ import annotations

import cv2
import numpy as np

from camtopod.vision.detect.background import LEARNING_SECONDS, Luma

SWAY_SHARE = 0.15
"""Share of the frames in which a pixel alternates, above which it is dynamic background."""
SWAY_PIXELS = 3
"""Radius (pixels) of the neighbourhood, the distance by which scenery may sway."""
_NEIGHBOURS = np.ones((3, 3), np.uint8)
_REACH = np.ones((2 * SWAY_PIXELS + 1, 2 * SWAY_PIXELS + 1), np.uint8)


class Swaying:
    """The dynamic background of one view."""

    def __init__(self, shape: tuple[int, int]) -> None:
        """Begin with a scene at rest, of ``shape`` (height, width)."""
        self._share = np.zeros(shape, np.float32)  # of the frames, times 255
        self._differs_before: Luma = np.zeros(shape, np.uint8)
        self._seconds = 0.0  # since the beginning

    def without(
        self, moving_mask: Luma, frame: Luma, expected: Luma, difference_min: float
    ) -> Luma:
        """Return the mask ``moving_mask`` (H, W) without dynamic background.

        expected (H, W): image of the scene.
        difference_min (grey levels): smallest difference of a moving pixel.
        """
        if cv2.norm(self._share, cv2.NORM_INF) <= 255 * SWAY_SHARE:
            return moving_mask
        sway_mask = np.where(self._share > 255 * SWAY_SHARE, np.uint8(255), np.uint8(0))
        above = cv2.subtract(frame, cv2.dilate(expected, _REACH))
        outside = cv2.max(above, cv2.subtract(cv2.erode(expected, _REACH), frame))
        _, within = cv2.threshold(outside, difference_min, 255, cv2.THRESH_BINARY_INV)
        return cv2.subtract(
            moving_mask, cv2.bitwise_and(within, cv2.dilate(sway_mask, _NEIGHBOURS))
        )

    def learn(self, differs: Luma, dt: float, free_mask: Luma) -> None:
        """Update each pixel's share of alternations, ``dt`` seconds after the last frame.

        differs (H, W): pixels that differ from the scene, including dynamic background.
        free_mask (H, W): 0 under confirmed objects, where nothing is counted.
        """
        self._seconds += dt
        constant = min(max(self._seconds, LEARNING_SECONDS / 3), LEARNING_SECONDS)
        flips = cv2.bitwise_xor(differs, self._differs_before)
        cv2.accumulateWeighted(flips, self._share, dt / constant, free_mask)
        self._differs_before = differs
