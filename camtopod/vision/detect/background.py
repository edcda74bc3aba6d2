"""The settled scene: what each pixel shows when nothing is in front of it.

A median over the first seconds, then a running mean of the pixels nothing moves in. Lighting is not
learned into the model but compensated by a tone curve from model to picture: for each of 16 levels
of the model, how bright such pixels are now. A cloud or an exposure change is then no motion, at
once and without relearning.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

Luma = cv2.typing.MatLike
"""A picture of grey levels or a mask: (H, W), uint8. (OpenCV types its pictures no closer.)"""

TONE_BINS = 16
_TONE_PIXELS_MIN = 24
"""Sampled pixels a level needs to have a say in the tone curve."""
SHIFT_MIN = 1.0
NOISE_DOUBT = 0.4
"""A median shift within the first plus the second times the noise is no change of light, grey
levels.
"""
_LEVELS = np.arange(256, dtype=np.float32)


class Background:
    """Model of the settled scene, (H, W) grey levels."""

    def __init__(self, frames: Sequence[Luma], seconds: float) -> None:
        """``frames`` are some seconds of pictures, at least one; ``seconds`` is the time constant
        of learning."""
        self._seconds = seconds
        stack = np.sort(np.stack(frames), axis=0)
        self._model = stack[len(frames) // 2].astype(np.float32)
        self._picture: Luma = stack[len(frames) // 2].copy()

    @property
    def picture(self) -> Luma:
        """The model as a picture."""
        return self._picture

    def expected(self, frame: Luma, settled: Luma, noise: float = 0.0) -> Luma:
        """The model under the light of ``frame``, judged where ``settled`` (H, W) is not 0.

        Shifts that ``noise`` (one sigma, grey levels) can feign are none: what is frozen would
        drift with them.
        """
        shift = self._tone_shift(frame, settled)
        doubt = SHIFT_MIN + NOISE_DOUBT * noise
        if np.abs(shift).max() <= doubt:
            return self._picture
        shift -= np.clip(shift, -doubt, doubt)
        curve = np.clip(_LEVELS + shift, 0, 255).astype(np.uint8)
        return np.asarray(cv2.LUT(self._picture, curve), dtype=np.uint8)

    def _tone_shift(self, frame: Luma, settled: Luma) -> npt.NDArray[np.float32]:
        """Grey levels to add to each of the model's 256 levels: the median change of the pixels
        around that level."""
        sample = settled[::4, ::4] != 0
        model = self._picture[::4, ::4][sample].astype(np.uint16)
        change = frame[::4, ::4][sample] + (256 - model)  # plus 256
        levels = model // (256 // TONE_BINS)
        # Sorted by level and then by change, the medians are in the middles of the levels.
        changes = np.sort(levels * 512 + change) % 512
        counts = np.bincount(levels, minlength=TONE_BINS)
        said = np.flatnonzero(counts >= _TONE_PIXELS_MIN)
        if not len(said):
            return np.zeros(256, np.float32)
        centres = np.bincount(levels, weights=model, minlength=TONE_BINS)[said] / counts[said]
        medians = changes[(np.cumsum(counts) - counts + counts // 2)[said]].astype(np.float32) - 256
        curve: npt.NDArray[np.float32] = np.interp(_LEVELS, centres, medians).astype(np.float32)
        return curve

    def learn(self, frame: Luma, expected: Luma, dt: float, settled: Luma) -> None:
        """Follow ``frame``, ``dt`` seconds after the last, where ``settled`` (H, W) is not 0.

        Elsewhere the model follows the light alone (``expected``), or what somebody stood in front
        of for a while would come to light in that of an earlier hour.
        """
        rate = 1.0 - float(np.exp(-dt / self._seconds))
        cv2.accumulateWeighted(cv2.copyTo(frame, settled, expected.copy()), self._model, rate)
        self._picture = cv2.convertScaleAbs(self._model)

    def adopt(self, frame: Luma, where: Luma) -> None:
        """Take ``frame`` over at once where ``where`` (H, W) is not 0: something was moved, or
        stood there at first."""
        cv2.copyTo(frame.astype(np.float32), where, self._model)
        self._picture = cv2.convertScaleAbs(self._model)
