"""Pixels of the image in which motion counts: all but those of the `ignore` polygons."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from camtopod.vision.detect.background import Luma
from camtopod.vision.settings import Polygon


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
