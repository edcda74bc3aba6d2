"""Scale images down to the working size by area means: halvings first, the rest in one step.

Means of 2 x 2 pixels are fast because processors vectorise them; a single step for everything costs
up to six times as much. Interpolating the rest instead would be cheaper still, but loses people.
"""

from __future__ import annotations

import cv2

from camtopod.vision.detect.background import Luma


def shrunk(image: Luma, side_max: int) -> Luma:
    """Return a copy of ``image`` scaled to at most ``side_max`` pixels on its longer side.

    image: (H, W), or in colour (H, W, 3).

    A portrait image so has as many pixels as the same image turned, and people as many in either.
    """
    height, width = image.shape[:2]
    longer = max(height, width)
    if longer <= side_max:
        return image.copy()
    size = (max(1, round(width * side_max / longer)), max(1, round(height * side_max / longer)))

    # Halve as long as possible.
    while (
        width >= 2 * size[0]
        and height >= 2 * size[1]
        and (width, height) != (3 * size[0], 3 * size[1])
    ):
        height, width = height // 2, width // 2
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)

    # Scale by the rest. By 3 (1080p to 320), every third running mean is the area mean.
    if (width, height) == (3 * size[0], 3 * size[1]):
        return cv2.blur(image, (3, 3))[1::3, 1::3].copy()
    return (
        image if (width, height) == size else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    )
