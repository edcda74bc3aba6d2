"""Where the picture is larger than the view: black bars, privacy masks, the corners of a fisheye.

These are areas at the border of the picture that are black, and in which nothing changes at all,
unlike in what a sensor sees in the dark. They count as ignored areas: who walks into one leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

import cv2
import numpy as np

from camtopod.arrays import Bools
from camtopod.vision.boxes import Box
from camtopod.vision.detect.background import Luma

LEVEL_MAX = 40
"""Brightest grey level of a blank area; video has black at 0 or 16, and masks are dark grey."""
RANGE_MAX = 2
"""Largest difference between the grey levels of a pixel of a blank area in several frames."""
SHARE_MAX = 0.75
"""Largest share of the picture that is blank beside a view; of more, the picture is dark."""
WIDTH_MIN = 0.025
"""Least width of a blank area as a share of the picture's diagonal.

A narrower one changes nothing: objects that near to the border of the picture are at the border.
"""


def blank_pixels(frames: Sequence[Luma]) -> Luma:
    """Return a mask (H, W): 255 in blank areas at the border of the picture.

    frames (H, W): some frames of the view.
    """
    lowest, highest = np.minimum.reduce(frames), np.maximum.reduce(frames)
    blank = ((highest <= LEVEL_MAX) & (highest - lowest <= RANGE_MAX)).astype(np.uint8)
    side = round(WIDTH_MIN * hypot(*blank.shape))
    square = np.ones((side, side), np.uint8)
    framed = cv2.copyMakeBorder(blank, side, side, side, side, cv2.BORDER_CONSTANT)
    framed = cv2.morphologyEx(framed, cv2.MORPH_OPEN, square)
    blank = framed[side:-side, side:-side]
    _, labels = cv2.connectedComponents(blank, connectivity=4)
    border = np.concatenate((labels[0], labels[-1], labels[:, 0], labels[:, -1]))
    mask = np.isin(labels, border[border > 0])
    if mask.mean() > SHARE_MAX:
        return np.zeros_like(blank)
    return mask.astype(np.uint8) * np.uint8(255)


def shown_part(mask: Bools) -> Box:
    """Return the part (left, top, right, bottom) of a picture that shows something, pixels.

    mask (H, W): True where it does. Rows and columns count of which half is shown.
    """
    columns, rows = mask.mean(axis=0) > 0.5, mask.mean(axis=1) > 0.5
    return (
        float(columns.argmax()),
        float(rows.argmax()),
        float(len(columns) - columns[::-1].argmax()),
        float(len(rows) - rows[::-1].argmax()),
    )
