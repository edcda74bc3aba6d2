"""Geometry of boxes in an image."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

Box = tuple[float, float, float, float]
"""Left, top, right, bottom in pixels; right and bottom are exclusive."""
Size = tuple[int, int]
"""Width and height of an image, pixels."""

OBJECTS_MAX = 300
"""Largest number of blobs, boxes or tracks at a time; of more, the weakest are left out."""
TOUCH_PIXELS = 1.5
"""Distance (pixels) within which the border of the image, or an ignored area, cuts a box."""


def box_height(box: Box) -> float:
    """Return the height, pixels."""
    return box[3] - box[1]


def area(box: Box) -> float:
    """Return the area, pixels."""
    return max(0.0, box[2] - box[0]) * max(0.0, box[3] - box[1])


def centre(box: Box) -> tuple[float, float]:
    """Return the centre (x, y)."""
    return (box[0] + box[2]) / 2, (box[1] + box[3]) / 2


def scaled(box: Box, factor: float) -> Box:
    """Return the box in an image that is ``factor`` times as large."""
    return (factor * box[0], factor * box[1], factor * box[2], factor * box[3])


def contains_centre(outer: Box, inner: Box) -> bool:
    """Return True if the centre of ``inner`` is in ``outer``."""
    x, y = centre(inner)
    return outer[0] <= x <= outer[2] and outer[1] <= y <= outer[3]


def union(a: Box, b: Box) -> Box:
    """Return the smallest box around both."""
    return (min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3]))


def intersection(a: Box, b: Box) -> Box | None:
    """Return the common part of two boxes; None if they have none."""
    if a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]:
        return None
    return (max(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), min(a[3], b[3]))


def common_area(a: Box, b: Box) -> float:
    """Return the area of the common part of two boxes, pixels."""
    common = intersection(a, b)
    return 0.0 if common is None else area(common)


def overlap(a: Box, b: Box) -> float:
    """Return the common area as a share of the smaller box, 0 to 1."""
    return common_area(a, b) / max(min(area(a), area(b)), 1.0)


def iou(a: Box, b: Box) -> float:
    """Return the intersection over union, 0 to 1."""
    common = common_area(a, b)
    return common / max(area(a) + area(b) - common, 1.0)


def gap(a: Box, b: Box) -> float:
    """Return the distance between two boxes in pixels, 0 where they overlap."""
    x = max(0.0, max(a[0], b[0]) - min(a[2], b[2]))
    y = max(0.0, max(a[1], b[1]) - min(a[3], b[3]))
    return hypot(x, y)


def border_distances(box: Box, view: Box) -> Box:
    """Return the distance to each side of a view (left, top, right, bottom), pixels."""
    return (box[0] - view[0], box[1] - view[1], view[2] - box[2], view[3] - box[3])


def pixels(box: Box, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the rows and columns of a box that are in an image of ``shape`` (H, W)."""
    left, right = (min(max(round(x), 0), shape[1]) for x in (box[0], box[2]))
    top, bottom = (min(max(round(y), 0), shape[0]) for y in (box[1], box[3]))
    return slice(top, bottom), slice(left, right)


def touches_border(box: Box, view: Box) -> bool:
    """Return True if the border of a view cuts the box."""
    return min(border_distances(box, view)) <= TOUCH_PIXELS


def to_border(box: Box, other_boxes: Sequence[Box], view: Box, reach: float) -> Box:
    """Return the box with each side moved to the border of a view that is within ``reach``
    pixels of it, if one of the others touches the border there.
    """
    left, top, right, bottom = (
        end
        if abs(value - end) <= reach
        and any(abs(neighbour[side] - end) <= TOUCH_PIXELS for neighbour in other_boxes)
        else value
        for side, (value, end) in enumerate(zip(box, view, strict=True))
    )
    return (left, top, right, bottom)
