"""Background model: each pixel of the settled scene with nothing in front of it.

The model is a median over the first seconds, then a running mean of the pixels without motion.
Lighting is not learned into the model but compensated by a tone curve from model to frame: for each
of 16 grey-level bins of the model, the median change of such pixels. A cloud or a change of
exposure then causes no motion, immediately and without relearning.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

Luma = cv2.typing.MatLike
"""Grey-level image or mask: (H, W), uint8. (OpenCV's types are no stricter.)"""

TONE_BINS = 16
"""Bins of grey levels in which the tone curve is estimated."""
_TONE_PIXELS_MIN = 24
"""Sampled pixels that a bin needs to take part in the tone curve."""
CONTRAST_SHARE_MIN = 0.1
"""Share of the scene's contrast that is left in any light; a card of a recorder leaves less."""
SHIFT_MIN = 1.0
"""Tone shifts (grey levels) up to this plus `SHIFT_NOISE_FACTOR` times the noise are ignored."""
SHIFT_NOISE_FACTOR = 0.4
"""Factor of the noise in the tone shifts that are ignored: see `SHIFT_MIN`."""
_LEVELS = np.arange(256, dtype=np.float32)


class Background:
    """Model of the settled scene, (H, W) grey levels."""

    def __init__(self, frames: Sequence[Luma], seconds: float) -> None:
        """Take the median of ``frames``, at least one, as the first model.

        seconds: time constant of learning.
        """
        self._seconds = seconds
        stack = np.sort(np.stack(frames), axis=0)
        self._model = stack[len(frames) // 2].astype(np.float32)
        self.image: Luma = stack[len(frames) // 2].copy()
        """The model as an image."""

    def expected(self, frame: Luma, settled: Luma, noise: float = 0.0) -> Luma:
        """Return the model under the light of ``frame``.

        settled (H, W): pixels that are not 0 determine the light.
        noise (one sigma, grey levels): tone shifts that noise can cause are ignored; otherwise
            pixels that are not learned would drift with them.
        """
        shift = self._tone_shift(frame, settled)
        doubt = SHIFT_MIN + SHIFT_NOISE_FACTOR * noise
        if np.abs(shift).max() <= doubt:
            return self.image
        shift -= np.clip(shift, -doubt, doubt)
        curve = np.clip(_LEVELS + shift, 0, 255).astype(np.uint8)
        return np.asarray(cv2.LUT(self.image, curve), dtype=np.uint8)

    def _tone_shift(self, frame: Luma, settled: Luma) -> npt.NDArray[np.float32]:
        """Return grey levels to add to each of the model's 256 levels, interpolated from the bins.

        Each bin has the median change of the sampled pixels (every fourth of every fourth row).
        """
        sample = settled[::4, ::4] != 0

        model = self.image[::4, ::4][sample].astype(np.uint16)
        change = frame[::4, ::4][sample] + (256 - model)  # plus 256, so that it is not negative
        levels = model // (256 // TONE_BINS)

        # Sorted by bin and then by change, the median of each bin is in its middle.
        changes = np.sort(levels * 512 + change) % 512
        counts = np.bincount(levels, minlength=TONE_BINS)

        filled = np.flatnonzero(counts >= _TONE_PIXELS_MIN)
        if not len(filled):
            return np.zeros(256, np.float32)

        centres = np.bincount(levels, weights=model, minlength=TONE_BINS)[filled] / counts[filled]
        medians = (
            changes[(np.cumsum(counts) - counts + counts // 2)[filled]].astype(np.float32) - 256
        )
        if np.ptp(centres + medians) < CONTRAST_SHARE_MIN * np.ptp(centres):
            return np.zeros(256, np.float32)  # nothing of the scene is in the frame
        curve: npt.NDArray[np.float32] = np.interp(_LEVELS, centres, medians).astype(np.float32)
        return curve

    def learn(self, frame: Luma, expected: Luma, dt: float, settled: Luma) -> None:
        """Adapt to ``frame``, ``dt`` seconds after the last, where ``settled`` (H, W) is not 0.

        Elsewhere the model follows the light alone (``expected``); otherwise an area that was
        covered for a while would reappear in the light of an earlier hour.
        """
        rate = 1.0 - float(np.exp(-dt / self._seconds))
        cv2.accumulateWeighted(cv2.copyTo(frame, settled, expected.copy()), self._model, rate)
        self.image = cv2.convertScaleAbs(self._model)

    def adopt(self, frame: Luma, where: Luma) -> None:
        """Replace the model by ``frame`` where ``where`` (H, W) is not 0.

        For objects that were moved, or that stood there at first.
        """
        cv2.copyTo(frame.astype(np.float32), where, self._model)
        self.image = cv2.convertScaleAbs(self._model)
