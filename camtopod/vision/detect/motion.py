"""Moving pixels against the settled scene, and which of the scene may be learned meanwhile.

Three things decide how well this works on real video: the background must not learn what stands
under a confirmed track; light must not be motion (tone curve in `background`, gradients here); and
freezing must end - a picture that changed as a whole is learned anew, and what nobody claims is
adopted after some seconds.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from camtopod.vision.detect.background import Background, Luma
from camtopod.vision.detect.shake import shift
from camtopod.vision.detect.wiener import NOISE_TO_FILTER, temporal_noise, wiener
from camtopod.vision.settings import VisionSettings

Box = tuple[float, float, float, float]
"""Left, top, right, bottom in pixels; right and bottom exclusive."""

DIFFERENCE_MIN = 15.0
"""A pixel moves from this difference on, grey levels, in a picture without noise."""
NOISE_FACTOR = 4.0
EDGE_MIN = 18.0
"""Step of the logarithmic difference between neighbours that a change of light does not make; 100
is a factor of e."""
STRONG_MIN = 75.0
"""Logarithmic difference that no shadow makes."""
WHOLE_PICTURE_SHARE = 0.5
WHOLE_PICTURE_SECONDS = 1.5
ADOPT_SECONDS = 6.0
"""What differs from the model for this long and belongs to no object becomes part of the scene."""
BOOTSTRAP_FRAMES_MAX = 24
GHOST_RATIO = 1.5
"""Along a ghost's outline the model has this many times the picture's gradient: what left is in the
model.
"""
SHAKE_PIXELS = 0.2
"""From this mean shake on, a pixel may show what the scene has beside it (which hides some
people).
"""
SHAKE_PIXELS_MAX = 2.0
_NOISE_RATE = 0.1
_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
_SQUARE = np.ones((3, 3), np.uint8)
_WIDE = np.ones((3, 3), np.uint8)
_DARK = 24.0
"""Below this level the logarithm flattens, so that noise in the dark is no edge."""
_LOGARITHM = np.clip(100 * np.log((np.arange(256) + _DARK) / _DARK), 0, 255).astype(np.uint8)


@dataclass(frozen=True, slots=True)
class Motion:
    """One frame against the settled scene, masks (H, W) of 0 and 255.

    ``changed``: differs from the scene; ``moving``: of these, without shadows and reflections;
    ``edges``: edges that the scene does not have; ``expected``: the picture of the scene in this
    light.
    """

    moving: Luma
    edges: Luma
    changed: Luma
    expected: Luma


class MotionDetector:
    """`bootstrap` once, then for each frame `look` and, after tracking, `learn`."""

    def __init__(self, settings: VisionSettings) -> None:
        self._settings = settings
        self._background: Background | None = None
        self._last: Luma | None = None
        self._noise = 0.0
        self._shake = 0.0
        self._changed_seconds = 0.0
        self.relearned = 0

    @property
    def ready(self) -> bool:
        """Whether there is a background to compare with."""
        return self._background is not None

    @property
    def disturbed(self) -> bool:
        """Whether most of the latest picture differs from the scene: nothing in it can be told
        apart.
        """
        return self._changed_seconds > 0.0

    @property
    def shake(self) -> float:
        """How far pictures lie off the scene, pixels, a running mean."""
        return self._shake

    @property
    def noise(self) -> float:
        """One-sigma temporal noise of the working picture, grey levels."""
        return self._noise

    def clean(self, frame: Luma) -> Luma:
        """Measure the noise of ``frame`` and filter it if there is enough of it."""
        if self._last is not None and self._last.shape == frame.shape:
            noise = temporal_noise(frame, self._last)
            self._noise += (_NOISE_RATE if self._noise else 1.0) * (noise - self._noise)
        self._last = frame
        if self._noise < NOISE_TO_FILTER:
            return frame
        return cv2.convertScaleAbs(wiener(frame, 3, self._noise**2))

    def bootstrap(self, frames: list[Luma]) -> None:
        """Take the median of (at most 24 of) ``frames`` as the settled scene."""
        step = -(-len(frames) // BOOTSTRAP_FRAMES_MAX)
        self._background = Background(frames[::step], self._settings.background_seconds)
        self._settled: Luma = np.full(frames[0].shape, 255, np.uint8)
        self._unclaimed_seconds: cv2.typing.MatLike = np.zeros(frames[0].shape, np.float32)
        self._changed_seconds = 0.0

    def look(self, frame: Luma, dt: float) -> Motion | None:
        """Moving pixels of ``frame``, ``dt`` seconds after the last; None when the whole picture
        has changed.

        After None the caller forgets its objects and bootstraps again.
        """
        assert self._background is not None, "bootstrap first"
        expected = self._background.expected(frame, self._settled, self._noise)
        x, y = shift(frame, expected, self._settled)
        self._shake += _NOISE_RATE * (min(abs(x) + abs(y), SHAKE_PIXELS_MAX) - self._shake)
        difference = (
            _beyond(frame, expected) if self._shake > SHAKE_PIXELS else cv2.absdiff(frame, expected)
        )
        threshold = max(DIFFERENCE_MIN, NOISE_FACTOR * min(self._noise, NOISE_TO_FILTER))
        moving = cv2.threshold(difference, threshold, 255, cv2.THRESH_BINARY)[1]
        share = cv2.countNonZero(moving) / moving.size
        self._changed_seconds = self._changed_seconds + dt if share > WHOLE_PICTURE_SHARE else 0.0
        if self._changed_seconds > WHOLE_PICTURE_SECONDS:
            self._background = None
            self.relearned += 1
            return None
        if share == 0.0:
            return Motion(moving, moving, moving, expected)
        edges, strong = self._own_texture(frame, expected)
        near = cv2.dilate(edges, _WIDE)
        solid = cv2.bitwise_and(moving, cv2.bitwise_or(near, strong))
        solid = cv2.bitwise_and(moving, _filled(solid))
        solid = cv2.morphologyEx(
            solid, cv2.MORPH_OPEN, _CROSS
        )  # outlines of furniture are lines, people are not
        return Motion(solid, edges, moving, expected)

    def _own_texture(self, frame: Luma, expected: Luma) -> tuple[Luma, Luma]:
        """Where the picture has edges the scene has not, and where it differs more than a shadow
        makes it.

        A shadow or a reflection multiplies the scene by a factor that varies slowly, so in
        logarithms it adds a flat patch, whatever texture lies below.
        """
        ratio = cv2.absdiff(cv2.LUT(frame, _LOGARITHM), cv2.LUT(expected, _LOGARITHM))
        steps = cv2.morphologyEx(ratio, cv2.MORPH_GRADIENT, _CROSS)
        edges = cv2.threshold(steps, EDGE_MIN, 255, cv2.THRESH_BINARY)[1]
        return edges, cv2.threshold(ratio, STRONG_MIN, 255, cv2.THRESH_BINARY)[1]

    def learn(self, frame: Luma, motion: Motion, dt: float, claimed: Iterable[Box]) -> None:
        """Follow the scene where nothing moves, outside ``claimed`` (the boxes of confirmed
        objects).
        """
        assert self._background is not None, "bootstrap first"
        unclaimed = motion.changed.copy()
        self._settled = cv2.bitwise_not(cv2.dilate(motion.changed, _SQUARE))
        for left, top, right, bottom in claimed:
            margin = max(2.0, 0.1 * (bottom - top))
            rows = slice(max(0, int(top - margin)), max(0, int(bottom + margin) + 1))
            columns = slice(max(0, int(left - margin)), max(0, int(right + margin) + 1))
            unclaimed[rows, columns] = 0
            self._settled[rows, columns] = 0
        self._background.learn(frame, motion.expected, dt, self._settled)
        if not cv2.countNonZero(unclaimed):
            self._unclaimed_seconds.fill(0.0)
            return
        self._unclaimed_seconds = cv2.copyTo(self._unclaimed_seconds + np.float32(dt), unclaimed)
        if float(self._unclaimed_seconds.max()) > ADOPT_SECONDS:
            self._adopt(
                frame, np.where(self._unclaimed_seconds > ADOPT_SECONDS, np.uint8(255), np.uint8(0))
            )

    def _adopt(self, frame: Luma, where: Luma) -> None:
        assert self._background is not None
        self._background.adopt(frame, where)
        self._unclaimed_seconds[where != 0] = 0.0

    def is_ghost(self, frame: Luma, motion: Motion, box: Box) -> bool:
        """Whether the moving pixels in ``box`` are where something *was*; if so the scene adopts
        what is there now."""
        assert self._background is not None, "bootstrap first"
        left, top, right, bottom = (max(0, int(value)) for value in box)
        rows, columns = slice(max(0, top - 2), bottom + 2), slice(max(0, left - 2), right + 2)
        mask = motion.moving[rows, columns]
        if mask.size == 0:
            return False
        outline = cv2.morphologyEx(mask, cv2.MORPH_GRADIENT, _SQUARE) != 0
        if not outline.any():
            return False
        now = cv2.morphologyEx(frame[rows, columns], cv2.MORPH_GRADIENT, _CROSS)[outline].mean()
        model = cv2.morphologyEx(
            self._background.picture[rows, columns], cv2.MORPH_GRADIENT, _CROSS
        )[outline].mean()
        if float(model) < GHOST_RATIO * max(1.0, float(now)):
            return False
        where = np.zeros(frame.shape, np.uint8)
        where[rows, columns] = cv2.dilate(mask, _SQUARE)
        self._adopt(frame, where)
        return True


def _filled(mask: Luma) -> Luma:
    """``mask`` and what it goes around: all that a flood from outside does not reach.

    A flood costs by the area, so it is let in only where there is something.
    """
    left, top, width, height = cv2.boundingRect(mask)
    if width == 0:
        return mask
    part = slice(top, top + height), slice(left, left + width)
    flooded = cv2.copyMakeBorder(mask[part], 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(0.0,))
    cv2.floodFill(flooded, None, (0, 0), (255.0,))
    filled = mask.copy()
    filled[part] = cv2.bitwise_or(
        mask[part], cv2.bitwise_not(flooded[1 : height + 1, 1 : width + 1])
    )
    return filled


def _beyond(frame: Luma, expected: Luma) -> Luma:
    """How far each pixel is outside of what the scene shows there or one pixel beside: cameras on
    poles shake."""
    above = cv2.subtract(frame, cv2.dilate(expected, _SQUARE))
    below = cv2.subtract(cv2.erode(expected, _SQUARE), frame)
    return cv2.max(above, below)
