"""Ignored areas, as the tracker meets them: an object that walks into one is lost at its edge.

Whether it has left the view depends on its way. If the area reaches to the border of the image
straight on, as a street along the top or a clock in a corner does, the area's edge is an edge of
the view. If the area ends within the view, as a tree does, the object is lost in mid-view.
"""

from __future__ import annotations

from math import hypot

import cv2
import numpy as np

from camtopod.vision.boxes import TOUCH_PIXELS, Box
from camtopod.vision.detect import Luma


class IgnoredAreas:
    """Ignored areas of one view; positions in pixels of the working image.

    watched_mask (H, W): 0 at ignored pixels.
    """

    def __init__(self, watched_mask: Luma) -> None:
        self._ignored_mask = np.asarray(watched_mask) == 0
        self._sums = cv2.integral(self._ignored_mask.astype(np.uint8))  # (H + 1, W + 1)

    def cut(self, box: Box) -> bool:
        """Return True if an ignored area cuts the box or touches it."""
        height, width = self._ignored_mask.shape
        left, right = (int(min(max(x, 0), width)) for x in (box[0] - TOUCH_PIXELS, box[2] + 2))
        top, bottom = (int(min(max(y, 0), height)) for y in (box[1] - TOUCH_PIXELS, box[3] + 2))
        sums = self._sums
        return bool(sums[bottom, right] - sums[top, right] > sums[bottom, left] - sums[top, left])

    def lead_out(
        self, foot: tuple[float, float], heading: tuple[float, float], lead: float, margin: float
    ) -> bool:
        """Return True if straight on from a foot point an ignored area reaches to the border.

        False if there is no area within ``lead`` pixels.

        heading: direction of the way (x, y), of any length.
        margin: pixels that may be left between an area and the border of the image.
        """
        height, width = self._ignored_mask.shape
        length = hypot(*heading)
        if length == 0.0 or not self._sums[-1, -1]:
            return False

        # Pixels along the way, up to the border of the image.
        steps = np.arange(width + height)
        start = min(max(foot[0], 0.0), width - 1.0), min(max(foot[1], 0.0), height - 1.0)
        columns = np.floor(start[0] + steps * heading[0] / length).astype(int)
        rows = np.floor(start[1] + steps * heading[1] / length).astype(int)
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        way = self._ignored_mask[rows[inside], columns[inside]]

        # Where the area begins and ends on it.
        begins = int(way.argmax())
        if not way[begins] or begins > lead:
            return False
        way_out = way[begins:]
        return bool(way_out.all()) or len(way_out) - int(way_out.argmin()) <= margin
