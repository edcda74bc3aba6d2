"""Wiener noise filter (thesis 4.1) built from box filters, and noise measurement.

The filter is that of ``scipy.signal.wiener`` (Lim, Two-Dimensional Signal and Image Processing,
1990, p. 548): a window whose variance does not exceed the noise is replaced by its mean; other
windows keep the share of their deviation that is signal.
"""

from __future__ import annotations

from math import sqrt
from statistics import NormalDist
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

NOISE_TO_FILTER = 2.5
"""Noise (one sigma, grey levels) below which filtering costs more detail than it removes noise."""
_TRIM = 0.75
"""Share of the pixels, the least changed, that the noise is measured by."""
_CHANGE = NormalDist(0.0, sqrt(2.0))
"""Change of a pixel between two frames, in units of one sigma of the noise."""
_TRIMMED_MEAN = 4 * (_CHANGE.pdf(0) - _CHANGE.pdf(_CHANGE.inv_cdf((1 + _TRIM) / 2))) / _TRIM
"""Mean size of the least changes, in the same units."""


def wiener(image: npt.NDArray[Any], size: int, noise: float) -> npt.NDArray[np.floating[Any]]:
    """Filter ``image`` (H, W) with a window of ``size`` x ``size`` pixels (odd).

    noise (grey levels squared): variance of the noise.

    float64 stays float64, every other type becomes float32. The image is padded with zeros.
    """
    depth, dtype = (
        (cv2.CV_64F, np.float64) if image.dtype == np.float64 else (cv2.CV_32F, np.float32)
    )
    window = (size, size)

    # Local mean and variance.
    mean = cv2.boxFilter(image, depth, window, borderType=cv2.BORDER_CONSTANT)
    squares = cv2.sqrBoxFilter(image, depth, window, borderType=cv2.BORDER_CONSTANT)

    # Where the variance does not exceed the noise, the weight is 0 and the mean remains.
    weight = 1.0 - noise / np.maximum(
        squares - mean * mean, max(noise, float(np.finfo(dtype).tiny))
    )
    return np.asarray(mean + weight * (image - mean), dtype=dtype)


def temporal_noise(
    frame: cv2.typing.MatLike, previous: cv2.typing.MatLike, watched_mask: cv2.typing.MatLike
) -> float:
    """Return the one-sigma noise (grey levels) between two consecutive frames (H, W).

    Every fourth pixel of every fourth row is used. The quarter of these that changed most is left
    out as motion.

    watched_mask (H, W): pixels that are 0 do not count.
    """
    now, before, mask = (
        np.ascontiguousarray(image[::4, ::4]) for image in (frame, previous, watched_mask)
    )
    counts = cv2.calcHist([cv2.absdiff(now, before)], [0], mask, [256], [0, 256])
    at_most = np.cumsum(counts)  # pixels that changed by at most 0, 1, ...
    sample_count = max(1, int(_TRIM * int(at_most[-1])))
    total = float(np.maximum(sample_count - at_most, 0).sum())
    return total / sample_count / _TRIMMED_MEAN
