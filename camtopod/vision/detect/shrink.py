"""Pictures down to the working size: halved as long as that goes, the rest in one step; pixels are
means of areas.

A mean of 2 x 2 pixels is what processors do many of at a time; all in one step costs up to six
times as much. Interpolating the rest instead would be cheaper still, but people are lost by it.
"""

from __future__ import annotations

import cv2

from camtopod.vision.detect.background import Luma


def shrunk(picture: Luma, width_max: int) -> Luma:
    """``picture`` (H, W) at most ``width_max`` pixels wide, in its proportions; never the same
    memory.
    """
    height, width = picture.shape
    if width <= width_max:
        return picture.copy()
    size = (width_max, round(height * width_max / width))
    while (
        width >= 2 * size[0]
        and height >= 2 * size[1]
        and (width, height) != (3 * size[0], 3 * size[1])
    ):
        height, width = height // 2, width // 2
        picture = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    if (width, height) == (
        3 * size[0],
        3 * size[1],
    ):  # 1080p to 320: every third of the running means is the same
        return cv2.blur(picture, (3, 3))[1::3, 1::3].copy()
    return (
        picture
        if (width, height) == size
        else cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    )
