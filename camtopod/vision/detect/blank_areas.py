"""Where the picture is larger than the view: black bars, privacy masks, the corners of a fisheye.

These are areas at the border of the picture that are black, all of one level that never changes,
unlike the dark parts of a scene. They count as ignored areas: objects that move into one leave.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

import cv2
import numpy as np

from camtopod.vision.detect.background import Luma

LEVEL_MAX = 40
"""Brightest grey level of a blank area; video has black at 0 or 16, and masks are dark grey."""
RANGE_MAX = 2
"""Largest difference between the grey levels of a pixel of a blank area in several frames.

The same between a pixel and the level of the blank areas.
"""
STEP_MIN = 10
"""Least step (grey levels, median along the edge) from blank areas to the view beside them.

The dark parts of a scene have no such edge.
"""
WIDTH_MIN = 0.025
"""Least width of a blank area as a share of the picture's diagonal.

A narrower one changes nothing: objects that near to the border of the picture are at the border.
"""
_NEIGHBOURS = np.ones((3, 3), np.uint8)


def blank_pixels(frames: Sequence[Luma]) -> Luma:
    """Return a mask (H, W): 255 in blank areas at the border of the picture.

    frames (H, W): some frames of the view.
    """
    lowest, highest = np.minimum.reduce(frames), np.maximum.reduce(frames)
    steady = (highest <= LEVEL_MAX) & (highest - lowest <= RANGE_MAX)
    levels = np.bincount(_border(highest)[_border(steady)], minlength=1)
    off = np.abs(highest.astype(np.int16) - int(levels.argmax()))
    blank = (steady & (off <= RANGE_MAX)).astype(np.uint8)
    side = round(WIDTH_MIN * hypot(*blank.shape)) | 1  # an even one would move the areas
    square = np.ones((side, side), np.uint8)
    blank = cv2.morphologyEx(
        blank, cv2.MORPH_OPEN, square, borderType=cv2.BORDER_CONSTANT, borderValue=(0,)
    )
    _, labels = cv2.connectedComponents(blank, connectivity=4)
    labels_there = _border(labels)
    blank = np.isin(labels, labels_there[labels_there > 0]).astype(np.uint8) * np.uint8(255)
    beside = cv2.subtract(cv2.dilate(blank, square), cv2.dilate(blank, _NEIGHBOURS)) > 0
    is_edge = beside.any() and np.median(off[beside]) >= STEP_MIN
    return blank if is_edge else np.zeros_like(blank)


def _border(image: Luma) -> Luma:
    """Return the pixels at the border of an image (H, W)."""
    return np.concatenate((image[0], image[-1], image[:, 0], image[:, -1]))
