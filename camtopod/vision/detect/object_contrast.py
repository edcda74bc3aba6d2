"""Contrast of the objects of a view: haze and a soiled dome take from it.

Whether a picture is hazy cannot be told from its grey levels: asphalt in the sun has as few. But
the strongest differences of confirmed objects from the scene are much the same wherever the picture
is clear, from above and at eye level, of people and of cars: 102 to 174 grey levels on twelve
clips.
"""

from __future__ import annotations

from math import exp

import cv2
import numpy as np

from camtopod.vision.detect.background import Luma

USUAL_DIFFERENCE = 100.0
"""Difference (grey levels) that the strongest pixels of objects have where the picture is clear."""
STRONG_SHARE = 0.05
"""Share of the moving pixels of objects that count as the strongest."""
CONTRAST_SHARE_MIN = 0.4
"""Least share of the usual motion that is enough, however faint the objects are."""
CONTRAST_SECONDS = 20.0
"""Time constant, seconds with objects in view, with which earlier objects are forgotten.

A clear picture is noticed at once, as a twentieth of the pixels is enough; haze that comes up
takes three times as long.
"""


class ObjectContrast:
    """Differences of the confirmed objects of one scene, by grey level."""

    def __init__(self, sensitivity: float = 1.0) -> None:
        """Begin without objects.

        sensitivity: the setting; above 1 it says that the usual contrast is less by this factor.
        """
        self._usual = USUAL_DIFFERENCE / max(sensitivity, 1.0)
        self._counts = np.zeros(256, np.float32)

    def add(self, difference: Luma, object_mask: Luma, dt: float) -> None:
        """Take a frame into account, ``dt`` seconds after the last.

        difference (H, W): difference of each pixel from the scene, grey levels.
        object_mask (H, W): not 0 where confirmed objects move.
        """
        counts = cv2.calcHist([difference], [0], object_mask, [256], [0, 256]).ravel()
        if counts.any():
            self._counts = exp(-dt / CONTRAST_SECONDS) * self._counts + counts

    @property
    def share(self) -> float:
        """Share of the usual motion that is enough, `CONTRAST_SHARE_MIN` to 1.

        It falls with the square of the contrast, since shadows, tremble and compression artefacts,
        which are no motion, fade as well. It is 1 until there are objects.
        """
        at_most = np.cumsum(self._counts)
        if not at_most[-1]:
            return 1.0
        strong = float(np.searchsorted(at_most, (1 - STRONG_SHARE) * at_most[-1]))
        return min(max((strong / self._usual) ** 2, CONTRAST_SHARE_MIN), 1.0)
