"""Motion detection against the settled scene, and selection of the pixels to learn.

Three rules make this work on real video: the background must not learn what stands under a
confirmed track; light must not count as motion (tone curve in `background`, gradients here); and no
pixel may stay frozen for ever: an image that has changed as a whole is learned again, and
differences that no track claims are adopted after some seconds. Dynamic background, such as
branches in the wind, is no motion either (`swaying`).

Ignored pixels (setting `ignore`) are never moving and never settled: they have no say in the noise,
the tone curve, the shake, the share of the image that has changed and the background model.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from camtopod.vision.boxes import Box, pixels
from camtopod.vision.detect import shake
from camtopod.vision.detect.background import (
    MEDIAN_SAMPLES,
    Background,
    Luma,
    is_other,
    view_image,
)
from camtopod.vision.detect.blank_areas import BlankAreas, blank_pixels
from camtopod.vision.detect.object_contrast import ObjectContrast
from camtopod.vision.detect.swaying import Swaying
from camtopod.vision.detect.wiener import NOISE_TO_FILTER, temporal_noise, wiener
from camtopod.vision.settings import Polygon, VisionSettings

DIFFERENCE_MIN = 15.0
"""Smallest difference (grey levels) of a moving pixel, in an image of medium grey without noise.

In a darker image all contrasts are less in proportion, and in haze (`object_contrast`).
"""
EDGE_MIN = 18.0
"""Smallest step of the logarithmic difference between neighbours that light does not cause.

In hundredths of e-folds: 100 is a factor of e.
"""
STRONG_MIN = 75.0
"""Smallest logarithmic difference that no shadow causes (100: a factor of e)."""
SUDDEN_SHARE = 0.15
"""Share of the image that no object takes from one frame to the next: light, or another scene.

A walking person who fills a third of the image needs half a second to enter it.
"""
CHANGED_SECONDS = 1.5
"""Time for which the image must have changed in one of these ways before it is learned again."""
ADOPT_SECONDS = 6.0
"""Time after which a difference that belongs to no object becomes part of the scene."""
SHAKE_PIXELS = 0.2
"""Mean shake (pixels) above which frames are aligned with the scene."""
AWAY_PIXELS = 1.5
"""Shift from the scene from which on a camera may stand elsewhere."""
HELD_PIXELS = 0.3
"""Largest change of the shift of a camera that stands still."""
HELD_SECONDS = 8.0
"""Time for which it has to stand still there."""
_NOISE_RATE = 0.1
"""Weight of the newest frame in the running means of noise and shake."""
_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
_SQUARE = np.ones((3, 3), np.uint8)
_DARK = 24.0
"""Level below which the logarithm flattens, so that noise in the dark makes no edges."""
_PLAIN_SHARE = 0.2
"""Standard deviation of a scene that shows nothing, as a share of the least difference."""
_DIM = 85.0
"""Mean level, a third of the range, below which less difference is motion, in proportion."""
_LOGARITHM = np.clip(100 * np.log((np.arange(256) + _DARK) / _DARK), 0, 255).astype(np.uint8)
"""Logarithm of each grey level, in hundredths of e-folds."""


@dataclass(frozen=True, slots=True)
class Motion:
    """One frame against the settled scene; masks (H, W) of 0 and 255."""

    frame: Luma
    """The frame, aligned with the scene if the camera shakes."""
    by: shake.Map
    """The map from the scene to the frame as it was."""
    moving_mask: Luma
    """Changed pixels without shadows and reflections."""
    change_mask: Luma
    """Pixels that differ from the scene, without dynamic background."""
    differs: Luma
    """Pixels that differ from the scene, with it."""
    expected: Luma
    """Image of the scene in the frame's light."""
    is_dim: bool
    """True if there is so little light that objects are seen in parts."""
    is_plain: bool
    """True if the scene has so little contrast that the picture shows nothing."""


class MotionDetector:
    """Motion of one view: call `bootstrap` once, then `detect` and, after tracking, `learn`."""

    def __init__(self, settings: VisionSettings) -> None:
        self._settings = settings
        self.ready = False
        """True if there is a background to compare with."""
        self._last: Luma | None = None
        self.noise = 0.0
        """One-sigma temporal noise of the working image, grey levels."""
        self.shake = 0.0
        """Running mean of the shift between images and scene, pixels."""
        self._view_image: Luma | None = None
        """The last scene that showed which view it is, as it was at first."""
        self.view: Box = (0.0, 0.0, 0.0, 0.0)
        """Part of the scene that the latest frame shows."""
        self.relearn_count = 0

    def filter_noise(self, frame: Luma) -> Luma:
        """Measure the noise of ``frame``; return the frame, filtered if it is noisy."""
        if self._last is None or self._last.shape != frame.shape:
            self.watched_mask = watched_pixels(self._settings.ignore, *frame.shape)
            """Mask (H, W): 0 where motion does not count, in ignored and in blank areas."""
            self.ready = False  # another size: another scene
        else:
            noise = temporal_noise(frame, self._last, self.watched_mask)
            self.noise += (_NOISE_RATE if self.noise else 1.0) * (noise - self.noise)
        self._last = frame
        if self.noise < NOISE_TO_FILTER:
            return frame
        return cv2.convertScaleAbs(wiener(frame, 3, self.noise**2))

    def bootstrap(self, frames: list[Luma]) -> bool:
        """Take the median of ``frames`` (some of them) as the settled scene.

        Returns True if it is another view than before, not the same in another light.
        """
        frames = frames[:: -(-len(frames) // MEDIAN_SAMPLES)]
        watched_mask = watched_pixels(self._settings.ignore, *frames[0].shape)
        blank = blank_pixels(frames)
        self.watched_mask = cv2.subtract(watched_mask, blank)
        self._blank_areas = BlankAreas(cv2.bitwise_and(blank, watched_mask), frames[-1])
        left, top, width, height = cv2.boundingRect(255 - blank)
        self._picture_view = (float(left), float(top), float(left + width), float(top + height))
        scene = frames[len(frames) // 2]
        shifts = [shake.shift(frame, scene, self.watched_mask) for frame in frames]
        self.shake = sum(shifts) / len(shifts)
        self._map = shake.IDENTITY
        """Where the latest image shows the places of the scene, while the camera shakes."""
        self._held_map, self._held_seconds = self._map, 0.0
        if self.shake > SHAKE_PIXELS:
            frames = [
                shake.warped(
                    frame, scene, shake.aligning(frame, scene, self.watched_mask, shake.IDENTITY)
                )
                for frame in frames
            ]
        self._background = Background(frames)
        self._expected = self._background.image
        earlier, view = self._view_image, view_image(self._expected, self.watched_mask)
        self._view_image = earlier if view is None else view
        self.ready = True
        self._settled_mask: Luma = self.watched_mask.copy()
        self._object_contrast = ObjectContrast(self._settings.sensitivity)
        self._swaying = Swaying(frames[0].shape[:2])
        self._unclaimed_seconds: cv2.typing.MatLike = np.zeros(frames[0].shape, np.float32)
        self._changed_seconds = 0.0
        self._moving_mask: Luma = (
            self.watched_mask
        )  # of the last frame; nothing is sudden in the first one
        self._sudden: Luma = np.zeros_like(self.watched_mask)
        return view is not None and earlier is not None and is_other(view, earlier)

    def detect(self, frame: Luma, dt: float) -> Motion | None:
        """Return the motion in ``frame``, ``dt`` seconds after the last.

        Returns None if light or another scene hides the objects. If the image has changed for good,
        the detector is not `ready` then; the caller forgets its objects and bootstraps again.
        """
        if self._blank_areas.are_shown(frame, dt):
            self._learn_anew()
            return None

        # If the camera shakes, the frame is aligned with the scene in the light of the last one.
        if self.shake > SHAKE_PIXELS:
            self._map = shake.aligning(frame, self._expected, self._settled_mask, self._map)
            if self._stands_elsewhere(frame, dt):
                return None
            frame = shake.warped(frame, self._expected, self._map)
            shift, by = shake.length(self._map, frame.shape), self._map
        else:
            by = shake.IDENTITY
            shift = shake.shift(frame, self._expected, self._settled_mask)
        self.shake += _NOISE_RATE * (shift - self.shake)
        expected = self._background.expected(frame, self._settled_mask, self.noise)
        self._expected = expected  # for the next frame
        difference = cv2.absdiff(frame, expected)
        self.view = self._picture_view
        if self.shake > SHAKE_PIXELS:
            # Alignment is accurate to a part of a pixel: edges may be off by one.
            self.view = shake.view(expected, self._map)
            above = cv2.subtract(frame, cv2.dilate(expected, _SQUARE))
            difference = cv2.max(above, cv2.subtract(cv2.erode(expected, _SQUARE), frame))

        # Moving pixels; an image that has changed for long ends this scene.
        moments = cv2.meanStdDev(expected, mask=self.watched_mask)
        level, contrast = (float(moment[0, 0]) for moment in moments)
        light = min((level + _DARK) / (_DIM + _DARK), 1.0)
        sensitivity = self._settings.sensitivity / min(light, self._object_contrast.share)
        least = DIFFERENCE_MIN * max(1.0 / sensitivity, min(self.noise / NOISE_TO_FILTER, 1.0))
        differs = cv2.threshold(difference, least, 255, cv2.THRESH_BINARY)[1]
        differs = cv2.bitwise_and(differs, self.watched_mask)
        moving_mask = self._swaying.without(differs, frame, expected, least)
        if self._has_changed(moving_mask):
            self._changed_seconds += dt
            if self._changed_seconds > CHANGED_SECONDS:
                self._learn_anew()
            return None
        self._changed_seconds = 0.0

        # Keep moving pixels near edges of the image's own, or that no shadow causes. A shadow
        # or a reflection multiplies the scene by a factor that varies slowly: in logarithms a
        # flat patch, whatever lies below. Edges are looked for two pixels around them.
        left, top, width, height = cv2.boundingRect(moving_mask)
        part = pixels((left - 2, top - 2, left + width + 2, top + height + 2), moving_mask.shape)
        ratio = cv2.absdiff(cv2.LUT(frame[part], _LOGARITHM), cv2.LUT(expected[part], _LOGARITHM))
        steps = cv2.dilate(cv2.morphologyEx(ratio, cv2.MORPH_GRADIENT, _CROSS), _SQUARE)
        near = cv2.threshold(steps, EDGE_MIN / sensitivity, 255, cv2.THRESH_BINARY)[1]
        strong = cv2.threshold(ratio, STRONG_MIN / sensitivity, 255, cv2.THRESH_BINARY)[1]
        solid = np.zeros_like(moving_mask)
        solid[part] = cv2.bitwise_and(moving_mask[part], cv2.bitwise_or(near, strong))
        # Opening removes lines, such as outlines of furniture.
        solid[part] = cv2.morphologyEx(solid[part], cv2.MORPH_OPEN, _CROSS)
        is_plain = contrast < _PLAIN_SHARE * least
        return Motion(frame, by, solid, moving_mask, differs, expected, light < 1.0, is_plain)

    def _stands_elsewhere(self, frame: Luma, dt: float) -> bool:
        """Return True if the camera stands still, but not where the scene is: it is learned anew.

        Otherwise a wrong map would stay: the scene is learned from what was aligned by it.
        """
        way = shake.length(self._map - self._held_map, frame.shape)
        if way > HELD_PIXELS or shake.length(self._map, frame.shape) < AWAY_PIXELS:
            self._held_map, self._held_seconds = self._map, 0.0
        self._held_seconds += dt
        if self._held_seconds > HELD_SECONDS:
            self._learn_anew()
        return not self.ready

    def _learn_anew(self) -> None:
        """End this scene."""
        self.ready = False
        self.relearn_count += 1

    def _has_changed(self, moving_mask: Luma) -> bool:
        """Return True if most of the image differs, or a large part of it since the last frame."""
        new_pixels = cv2.subtract(moving_mask, self._moving_mask)
        self._moving_mask = moving_mask
        large = SUDDEN_SHARE * cv2.countNonZero(self.watched_mask)
        stays = cv2.countNonZero(cv2.bitwise_and(moving_mask, self._sudden))
        if stays > min(large, cv2.countNonZero(self._sudden) / 2):
            return True
        moving_count = cv2.countNonZero(moving_mask)
        new = cv2.countNonZero(new_pixels)
        is_sudden = new > large and 2 * new > moving_count
        self._sudden = new_pixels if is_sudden else np.zeros_like(moving_mask)
        return is_sudden or 2 * moving_count > cv2.countNonZero(self.watched_mask)

    def learn(self, motion: Motion, dt: float, boxes: Iterable[Box]) -> None:
        """Adapt to the scene where nothing moves.

        boxes: boxes of confirmed objects, whose pixels are not learned.
        """
        # Exclude moving pixels and, with a margin, confirmed objects.
        free = np.full(motion.change_mask.shape, 255, np.uint8)
        for left, top, right, bottom in boxes:
            margin = max(2.0, 0.1 * (bottom - top))
            cv2.rectangle(
                free,
                (int(left - margin), int(top - margin)),
                (int(right + margin), int(bottom + margin)),
                (0.0,),
                cv2.FILLED,
            )
        self._settled_mask = cv2.bitwise_and(
            cv2.subtract(free, cv2.dilate(motion.change_mask, _SQUARE)), self.watched_mask
        )

        if not motion.is_dim:  # contrasts in little light say nothing of brighter light
            difference = cv2.absdiff(motion.frame, motion.expected)
            self._object_contrast.add(difference, cv2.subtract(motion.moving_mask, free), dt)
        self._swaying.learn(motion.differs, dt, free)
        self._background.learn(motion.frame, motion.expected, dt, self._settled_mask)

        # Adopt differences that no object has claimed for long.
        self._unclaimed_seconds = cv2.copyTo(
            self._unclaimed_seconds + np.float32(dt), cv2.bitwise_and(motion.change_mask, free)
        )
        if float(self._unclaimed_seconds.max()) > ADOPT_SECONDS:
            self._background.adopt(
                motion.frame, (self._unclaimed_seconds > ADOPT_SECONDS).astype(np.uint8)
            )

    def is_ghost(self, motion: Motion, box: Box) -> bool:
        """Return True if ``box`` holds a ghost: motion where an object *was*.

        The scene then adopts the current image there.
        """
        left, top, right, bottom = (max(0, int(value)) for value in box)
        part = slice(max(0, top - 2), bottom + 2), slice(max(0, left - 2), right + 2)
        mask = motion.moving_mask[part]
        if mask.size == 0:
            return False
        outline = cv2.morphologyEx(mask, cv2.MORPH_GRADIENT, _SQUARE) != 0
        if not outline.any():
            return False

        # Compare the gradients along the outline.
        now, model = (
            cv2.morphologyEx(image[part], cv2.MORPH_GRADIENT, _CROSS)[outline].mean()
            for image in (motion.frame, self._background.image)
        )
        if model < now:
            return False

        # Adopt the image.
        ghost_mask = np.zeros(motion.frame.shape, np.uint8)
        ghost_mask[part] = cv2.dilate(mask, _SQUARE)
        self._background.adopt(motion.frame, ghost_mask)
        return True


def watched_pixels(ignore: Sequence[Polygon], height: int, width: int) -> Luma:
    """Return a mask (H, W): 255 where motion counts, 0 in ``ignore``.

    A pixel is ignored if the polygon covers its middle or passes through it.
    """
    mask = np.full((height, width), 255, np.uint8)
    for polygon in ignore:
        corners = np.array(polygon) * (width, height) - 0.5  # pixel (0, 0) has its middle at 0.5
        cv2.fillPoly(mask, [corners.round().astype(np.int32)], (0.0,))
    return mask
