"""Wiener noise reduction (thesis 4.1) out of box filters, and how noisy a picture is.

The filter is that of ``scipy.signal.wiener`` (Lim, Two-Dimensional Signal and Image Processing,
1990, p. 548): a window with no more variance than the noise is replaced by its mean, others keep
the share of their deviation that is signal.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

NOISE_TO_FILTER = 2.5
"""Below this noise, grey levels (one sigma), filtering costs more detail than it takes noise
away.
"""
_TRIM = 0.75
_TRIMMED_MEAN = 0.5147
"""Mean of the lowest 75 % of |z| for standard normal z."""


def wiener(
    image: npt.NDArray[Any], size: int = 3, noise: float | None = None
) -> npt.NDArray[np.floating[Any]]:
    """Filter ``image`` (H, W) with a window of ``size`` x ``size`` (odd).

    ``noise`` is the variance of the noise, grey levels squared; without it, the mean of the local
    variances as in scipy (which takes texture for noise). float64 stays float64, everything else
    becomes float32. Outside the picture everything is zero.
    """
    depth, dtype = (
        (cv2.CV_64F, np.float64) if image.dtype == np.float64 else (cv2.CV_32F, np.float32)
    )
    window = (size, size)
    mean = cv2.boxFilter(image, depth, window, borderType=cv2.BORDER_CONSTANT)
    variance = cv2.sqrBoxFilter(image, depth, window, borderType=cv2.BORDER_CONSTANT)
    variance = variance - mean * mean
    if noise is None:
        noise = float(variance.mean())
    # Where the variance is at most the noise the weight is 0, which is the mean alone.
    weight = 1.0 - noise / np.maximum(variance, max(noise, float(np.finfo(dtype).tiny)))
    return np.asarray(mean + weight * (image - mean), dtype=dtype)


def temporal_noise(frame: cv2.typing.MatLike, previous: cv2.typing.MatLike) -> float:
    """One-sigma noise in grey levels from two neighbouring frames (H, W), by each fourth pixel of
    each fourth row.

    The quarter of the pixels that changed most is left out: that is motion.
    """
    change = cv2.absdiff(
        *(np.ascontiguousarray(picture[::4, ::4]) for picture in (frame, previous))
    )
    kept = max(1, int(change.size * _TRIM))
    at_most = np.cumsum(np.bincount(change.ravel()))  # so many pixels changed by 0, by 0 or 1, ...
    total = int(np.maximum(kept - at_most, 0).sum())
    return total / kept / _TRIMMED_MEAN / sqrt(2.0)
