"""Where the picture is larger than the view: black bars, privacy masks, the corners of a fisheye.

These are areas at the border of the picture that are black, all of one level that never changes,
unlike the dark parts of a scene. They count as ignored areas: objects that move into one leave.
Once they show something, as the dark side of a yard does by day, the scene is learned anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

import cv2
import numpy as np
import numpy.typing as npt

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
SHOWN_SHARE = 0.25
"""Share of the blank pixels that show something, such as one tile of several, not a text alone."""
SHOWN_SECONDS = 8.0
"""Time for which they have to show something; headlights pass."""
_STRIDE = 8
"""Rows and columns (pixels) from one that is looked at again to the next."""
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


class BlankAreas:
    """The blank areas of one scene, as long as they show nothing."""

    def __init__(self, mask: Luma, frame: Luma) -> None:
        """Begin with the blank pixels, those of a mask (H, W) that are not 0, as in ``frame``."""
        self._is_blank = mask[::_STRIDE, ::_STRIDE] != 0
        self._levels = self._looked_at(frame)
        self._shown_seconds = 0.0

    def _looked_at(self, frame: Luma) -> npt.NDArray[np.int16]:
        """Return the levels of the pixels that are looked at, (pixels,)."""
        return np.asarray(frame[::_STRIDE, ::_STRIDE][self._is_blank], np.int16)

    def are_shown(self, frame: Luma, dt: float) -> bool:
        """Return True if they have shown something for long, up to ``frame``.

        dt: time from the last frame, seconds.
        """
        changes = np.abs(self._looked_at(frame) - self._levels)
        is_shown = np.count_nonzero(changes >= STEP_MIN) > SHOWN_SHARE * len(changes)
        self._shown_seconds = self._shown_seconds + dt if is_shown else 0.0
        return self._shown_seconds > SHOWN_SECONDS
