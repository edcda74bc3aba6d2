"""Expected calibration error: how far stated probabilities are from observed frequencies."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

CALIBRATION_BINS = 10
"""Number of equal bins of probability."""


def calibration_error(probability: Sequence[float], happened: Sequence[bool]) -> float:
    """Return the expected calibration error; nan without any probability.

    It is |mean stated probability - observed frequency| of equal bins of probability, averaged with
    the number of outcomes in each bin as weight.
    """
    if not probability:
        return math.nan
    stated = np.array(probability)
    came = np.array(happened, dtype=float)
    gap = np.bincount(_bin(stated), stated - came, CALIBRATION_BINS)
    return float(np.abs(gap).sum() / len(stated))


def calibration_floor(probability: Sequence[float]) -> float:
    """Return the expected calibration error of as many perfectly calibrated probabilities; nan
    without any.

    An error of this size is explained by chance alone.
    """
    if not probability:
        return math.nan
    stated = np.array(probability)
    variance = np.bincount(_bin(stated), stated * (1.0 - stated), CALIBRATION_BINS)
    return float(math.sqrt(2.0 / math.pi) * np.sqrt(variance).sum() / len(stated))


def _bin(stated: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.minimum((stated * CALIBRATION_BINS).astype(np.int64), CALIBRATION_BINS - 1)
