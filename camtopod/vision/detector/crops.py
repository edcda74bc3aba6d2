"""Crops for a detector's model: the part of the image in which something moves or is tracked.

A crop has the shape of the model's input, so that a small person far away fills more of it than of
the whole image.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

from camtopod.vision.boxes import Box, Size, box_height, union

MARGIN_HEIGHTS = 0.5
"""Margin around the regions (heights of the tallest): motion shows some of a person only."""
ENLARGED_MAX = 3.0
"""Largest factor by which a crop is enlarged: beyond it there is no more detail."""


def crop_around(regions: Sequence[Box], size: Size, input_size: Size) -> Box:
    """Return the smallest crop that holds all regions with a margin, at most the whole image.

    regions, result: in pixels of an image of ``size``. What the shape of the input needs beyond
    the image is outside of it.
    input_size (width, height): the model's input, pixels.
    """
    left, top, right, bottom = reduce(union, regions)
    margin = MARGIN_HEIGHTS * max(map(box_height, regions))
    aspect = input_size[0] / input_size[1]
    height = max(bottom - top + 2 * margin, (right - left + 2 * margin) / aspect)
    height = max(height, input_size[1] / ENLARGED_MAX)
    height = min(height, max(size[1], size[0] / aspect))
    width = height * aspect

    # Around the regions, moved into the image, or around it.
    _, x, _ = sorted(((left + right - width) / 2, 0.0, size[0] - width))
    _, y, _ = sorted(((top + bottom - height) / 2, 0.0, size[1] - height))
    return (x, y, x + width, y + height)


def whole(size: Size, input_size: Size) -> Box:
    """Return the crop that holds the whole image of ``size`` (width, height), in its middle."""
    return crop_around([(0.0, 0.0, *size)], size, input_size)
