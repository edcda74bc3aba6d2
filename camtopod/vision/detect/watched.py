"""Pixels of the image in which motion counts: all but those of the `ignore` polygons."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from camtopod.vision.detect.background import Luma
from camtopod.vision.settings import Polygon

_SHARE_PIXELS = 500
"""Width and height (pixels) of the image in which `ignored_share` counts."""


def watched_pixels(ignore: Sequence[Polygon], height: int, width: int) -> Luma | None:
    """Return a mask (H, W): 255 where motion counts, 0 in ``ignore``; None if that is empty.

    A pixel is ignored if the polygon covers its middle or passes through it.
    """
    if not ignore:
        return None
    mask = np.full((height, width), 255, np.uint8)
    for polygon in ignore:
        corners = np.array(polygon) * (width, height) - 0.5  # pixel (0, 0) has its middle at 0.5
        cv2.fillPoly(mask, [corners.round().astype(np.int32)], (0.0,))
    return mask


def ignored_share(ignore: Sequence[Polygon]) -> float:
    """Return the share of the image's area in the polygons ``ignore``, 0 to 1."""
    mask = watched_pixels(ignore, _SHARE_PIXELS, _SHARE_PIXELS)
    return 0.0 if mask is None else 1.0 - cv2.countNonZero(mask) / mask.size
