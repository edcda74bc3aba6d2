"""A simple detector for the examples: boxes around moving pixels. Any other detector will do."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

AREA_MIN = 0.002
"""Smallest box that is not noise, share of the picture."""
LEARNED_FRAMES = 8
"""Frames from which the background is learned first."""


class Moving:
    """Iterates over a video after the background is learned: seconds, boxes (n, 4) in pixels."""

    def __init__(self, path: str) -> None:
        self._video = cv2.VideoCapture(path)
        self.fps = self._video.get(cv2.CAP_PROP_FPS)
        self.size = (
            self._video.get(cv2.CAP_PROP_FRAME_WIDTH),
            self._video.get(cv2.CAP_PROP_FRAME_HEIGHT),
        )

    def __iter__(self) -> Iterator[tuple[float, np.ndarray]]:
        background = cv2.createBackgroundSubtractorMOG2(history=300)
        number = 0
        while (picture := self._video.read()[1]) is not None:
            mask = background.apply(picture) == 255
            if number >= LEARNED_FRAMES:
                yield number / self.fps, _boxes(mask.astype(np.uint8))
            number += 1


def _boxes(mask: np.ndarray) -> np.ndarray:
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    mask = cv2.dilate(mask, np.ones((9, 5), np.uint8), iterations=2)
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    found = [cv2.boundingRect(outline) for outline in outlines]
    return np.array(
        [(x, y, x + w, y + h) for x, y, w, h in found if w * h >= AREA_MIN * mask.size]
    ).reshape(-1, 4)
