"""Background model: each pixel of the settled scene with nothing in front of it.

The model is a median over the first seconds, then a running mean of the pixels without motion.
Lighting is not learned into the model but compensated by a tone curve from model to frame: for each
of 16 grey-level bins of the model, the median change of such pixels. A cloud or a change of
exposure then causes no motion, immediately and without relearning.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

import cv2
import numpy as np
import numpy.typing as npt

Luma = cv2.typing.MatLike
"""Grey-level image or mask: (H, W), uint8. (OpenCV's types are no stricter.)"""

TONE_BINS = 16
"""Bins of grey levels in which the tone curve is estimated."""
MEDIAN_SAMPLES = 24
"""Samples that a median takes: of the tone in a bin at least, of the first frames at most."""
LEARNING_SECONDS = 20.0
"""Time constant with which the background follows changes of the settled scene."""
CONTRAST_SHARE_MIN = 0.1
"""Share of the scene's contrast that is left in any light; a card of a recorder leaves less."""
LIGHT_MIN, LIGHT_MAX = 0.5, 2.0
"""Factors of the light within which grey levels beyond the bins change as the outermost bins do."""
SAME_VIEW_MIN = 0.25
"""Least phase correlation of two images of one view.

It is 0.28 and more in most lights, and at most 0.22 of the views of different clips.
"""
MOVED_SHARE_MAX = 0.025
"""Largest shift between two images of one view, as a share of the diagonal."""
DARK_MAX = 24.0
"""Mean level below which an image, as that of a covered lens, does not show which view it is."""
PLAIN_MAX = 4.0
"""Standard deviation (grey levels) below which it does not either, as a sheet or a card."""
_LEVELS = np.arange(256, dtype=np.float32)


class Background:
    """Model of the settled scene, (H, W) grey levels."""

    def __init__(self, frames: Sequence[Luma]) -> None:
        """Take the median of ``frames``, at least one, as the first model."""
        stack = np.sort(np.stack(frames), axis=0)
        self._model = stack[len(frames) // 2].astype(np.float32)
        self.image: Luma = stack[len(frames) // 2].copy()
        """The model as an image."""

    def expected(self, frame: Luma, settled_mask: Luma, noise: float = 0.0) -> Luma:
        """Return the model under the light of ``frame``.

        settled_mask (H, W): pixels that are not 0 determine the light.
        noise (one sigma, grey levels): tone shifts that noise can cause are ignored; otherwise
            pixels that are not learned would drift with them.
        """
        shift = self._tone_shift(frame, settled_mask)
        doubt = max(1.0, noise / 2)
        shift -= np.clip(shift, -doubt, doubt)
        curve = np.clip(_LEVELS + shift, 0, 255).astype(np.uint8)
        return np.asarray(cv2.LUT(self.image, curve), dtype=np.uint8)

    def _tone_shift(self, frame: Luma, settled_mask: Luma) -> npt.NDArray[np.float32]:
        """Return grey levels to add to each of the model's 256 levels, interpolated from the bins.

        Each bin has the median change of the sampled pixels (every fourth of every fourth row).
        """
        sample = settled_mask[::4, ::4] != 0

        model = self.image[::4, ::4][sample].astype(np.uint16)
        change = frame[::4, ::4][sample] + (256 - model)  # plus 256, so that it is not negative
        levels = model // (256 // TONE_BINS)

        # Sorted by bin and then by change, the median of each bin is in its middle.
        changes = np.sort(levels * 512 + change) % 512
        counts = np.bincount(levels, minlength=TONE_BINS)

        filled_levels = np.flatnonzero(counts >= MEDIAN_SAMPLES)
        if not len(filled_levels):
            return np.zeros(256, np.float32)

        centres = (
            np.bincount(levels, weights=model, minlength=TONE_BINS)[filled_levels]
            / counts[filled_levels]
        )
        medians = (
            changes[(np.cumsum(counts) - counts + counts // 2)[filled_levels]].astype(np.float32)
            - 256
        )
        if np.ptp(centres + medians) < CONTRAST_SHARE_MIN * np.ptp(centres):
            return np.zeros(256, np.float32)  # nothing of the scene is in the frame

        # Beyond the bins a great change of light is a factor.
        if not LIGHT_MIN <= 1.0 + medians.sum() / max(centres.sum(), 1.0) <= LIGHT_MAX:
            brightest = medians[-1] / max(centres[-1], 1.0) * _LEVELS[-1]
            medians = np.array([0.0, *medians, brightest])
            centres = np.array([0.0, *centres, _LEVELS[-1]])
        return np.asarray(np.interp(_LEVELS, centres, medians), np.float32)

    def learn(self, frame: Luma, expected: Luma, dt: float, settled_mask: Luma) -> None:
        """Adapt to ``frame``, ``dt`` seconds after the last, where ``settled_mask`` is not 0.

        Elsewhere the model follows the light alone (``expected``); otherwise an area that was
        occluded for a while would reappear in the light of an earlier hour.
        """
        rate = 1.0 - float(np.exp(-dt / LEARNING_SECONDS))
        cv2.accumulateWeighted(cv2.copyTo(frame, settled_mask, expected.copy()), self._model, rate)
        self.image = cv2.convertScaleAbs(self._model)

    def adopt(self, frame: Luma, mask: Luma) -> None:
        """Replace the model by ``frame`` where ``mask`` (H, W) is not 0.

        For objects that were moved, or that stood there at first.
        """
        cv2.copyTo(frame.astype(np.float32), mask, self._model)
        self.image = cv2.convertScaleAbs(self._model)


def view_image(scene: Luma, mask: Luma) -> Luma | None:
    """Return the image by which a view is recognised; None if the scene does not show it.

    scene (H, W): grey levels; pixels where ``mask`` is 0 are set to the mean of the others.
    """
    (level,), (contrast,) = (moment[0] for moment in cv2.meanStdDev(scene, mask=mask))
    if level <= DARK_MAX or contrast <= PLAIN_MAX:
        return None
    return np.where(mask != 0, scene, np.uint8(level))


def is_other(view: Luma, earlier: Luma) -> bool:
    """Return True if a view (H, W) is not the earlier one in another light: a camera was turned."""
    if view.shape != earlier.shape:
        return True
    # At half the size, where there is less noise.
    now, before = (cv2.pyrDown(image).astype(np.float32) for image in (view, earlier))
    window = cv2.createHanningWindow(now.shape[::-1], cv2.CV_32F)
    shift, correlation = cv2.phaseCorrelate(now, before, window)
    has_moved = hypot(*shift) > MOVED_SHARE_MAX * hypot(*now.shape)
    return correlation < SAME_VIEW_MIN or has_moved
