"""Boxes of objects: which can be one, and where the object stands."""

from __future__ import annotations

import math
from collections.abc import Sequence

BOX_MAX = 4.0
"""Widest box, in widths of the picture; wider ones are in another unit."""


def is_box(corners: Sequence[float], size: tuple[float, float]) -> bool:
    """Return True for left, top, right, bottom with an area, larger than a pixel.

    size (pixels): of the picture; (1, 1) if boxes are fractions of it.
    """
    left, top, right, bottom = corners
    if not all(map(math.isfinite, corners)) or right <= left or bottom <= top:
        return False
    return size == (1, 1) or right - left > 1 or bottom - top > 1


def in_picture(
    box: tuple[float, float, float, float], outside_max: float
) -> tuple[float, float] | None:
    """Return the foot point of a box, clipped to the picture; None if all of it is far outside.

    box: left, top, right, bottom, fractions of the picture. It may be a point.
    """
    left, top, right, bottom = box
    if max(-right, left - 1, -bottom, top - 1) > outside_max or right - left > BOX_MAX:
        return None
    return round(min(max((left + right) / 2, 0.0), 1.0), 4), round(min(max(bottom, 0.0), 1.0), 4)
