"""Is what is stated as a probability as often true? Expected calibration error, and what chance
alone makes of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

CALIBRATION_BINS = 10


def calibration_error(probability: Sequence[float], happened: Sequence[bool]) -> float:
    """Expected calibration error: over equal bins of probability, the mean of |stated - happened|,
    weighted by how many lie in each; nan without any."""
    if not probability:
        return math.nan
    stated, came = np.array(probability), np.array(happened, dtype=float)
    gap = np.bincount(_bin(stated), stated - came, CALIBRATION_BINS)
    return float(np.abs(gap).sum() / len(stated))


def calibration_floor(probability: Sequence[float]) -> float:
    """Expected calibration error if all happens as often as it is said to: as large as that is no
    error; nan without any."""
    if not probability:
        return math.nan
    stated = np.array(probability)
    variance = np.bincount(_bin(stated), stated * (1.0 - stated), CALIBRATION_BINS)
    return float(math.sqrt(2.0 / math.pi) * np.sqrt(variance).sum() / len(stated))


def _bin(stated: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.minimum((stated * CALIBRATION_BINS).astype(np.int64), CALIBRATION_BINS - 1)
