"""Image of a scene without its people: the median of images over some seconds.

A walking person covers a pixel in few of the images, so the median shows the background. The scene
is settled if nearly every pixel looks the same in a clear majority of them. A person who stands
still for the whole time is part of the scene.
"""

from __future__ import annotations

import cv2
import numpy as np

from camtopod.vision.detect import Luma, shrunk

SETTLE_SECONDS_MIN = 6.0
"""Least time of the pictures: slow people take some seconds to leave a place."""
SETTLE_SECONDS_MAX = 30.0
"""Time after which the best picture is taken, settled or not."""
SPACING_SECONDS = 0.5
"""Time between two pictures at first; it doubles each time that there are `PICTURES_MAX`."""
PICTURES_MAX = 16
"""Pictures that are kept, at most 2.8 MB each."""
MAJORITY = 0.6
"""Share of the pictures in which a settled pixel looks as in the median."""
LATEST_PICTURES = 3
"""Number of latest images; a pixel that differs from the median in all of them is not settled."""
SAME_GREY_LEVELS = 15
"""Largest difference of pixels that look the same, grey levels."""
UNSETTLED_SHARE_MAX = 0.002
"""Share of pixels that may be unsettled in a settled scene."""
_COMPARED_WIDTH = 320
"""Width (pixels) of the pictures that are compared."""
_ROWS = 64
"""Rows of which the median is taken at once, to save memory."""

Picture = cv2.typing.MatLike
"""Colour picture (H, W, 3) or luma (H, W), uint8."""


class SettledPicture:
    """Takes pictures of one view until its scene is settled."""

    def __init__(self) -> None:
        self._pictures: list[tuple[float, Picture]] = []
        """Times (seconds) and pictures."""
        self._compared: list[Luma] = []
        """The same pictures, small and without colour."""
        self._spacing = SPACING_SECONDS
        self.settled = False
        """True if nearly every pixel looks the same in a majority of the pictures."""

    @property
    def seconds(self) -> float:
        """Time from the first to the last picture."""
        return self._pictures[-1][0] - self._pictures[0][0] if self._pictures else 0.0

    def wants(self, t: float) -> bool:
        """Return True if a picture taken at ``t`` (seconds) is needed."""
        return not self._pictures or t - self._pictures[-1][0] >= self._spacing

    def add(self, t: float, picture: Picture) -> None:
        """Add a picture taken at ``t`` (seconds); all are of one size."""
        # Make room: every second one, from now on at twice the spacing.
        if len(self._pictures) == PICTURES_MAX:
            self._pictures = self._pictures[::2]
            self._compared = self._compared[::2]
            self._spacing *= 2
            if not self.wants(t):
                return

        self._pictures.append((t, picture))
        grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        self._compared.append(shrunk(grey, _COMPARED_WIDTH))
        long_enough = self.seconds >= SETTLE_SECONDS_MIN
        self.settled = long_enough and self._unsettled_share() <= UNSETTLED_SHARE_MAX

    def _unsettled_share(self) -> float:
        """Return the share of pixels that differ from the median in too many pictures."""
        stack = np.stack(self._compared)
        middle = _median(stack)
        same = np.stack([cv2.absdiff(one, middle) <= SAME_GREY_LEVELS for one in stack])
        minority = same.sum(axis=0) < MAJORITY * len(stack)
        lately = ~same[-LATEST_PICTURES:].any(axis=0)  # somebody has come or gone
        return float(np.mean(minority | lately))

    def picture(self) -> Picture | None:
        """Return the median of the pictures; None if there is none."""
        if not self._pictures:
            return None
        pictures = [picture for _, picture in self._pictures]
        result = pictures[0].copy()
        for top in range(0, len(result), _ROWS):
            rows = slice(top, top + _ROWS)
            result[rows] = _median(np.stack([picture[rows] for picture in pictures]))
        return result


def _median(stack: Picture) -> Picture:
    """Return the median (H, W, ...) of a stack (N, H, W, ...)."""
    middle = len(stack) // 2
    return np.asarray(np.partition(stack, middle, axis=0)[middle], np.uint8)
