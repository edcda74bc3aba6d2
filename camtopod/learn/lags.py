"""Counts by lag against the null model: by how much they exceed what unrelated events make."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats
from camtopod.topology import lag_smoothing_matrix

BIN_SECONDS = 1.0
"""Seconds by which lags are told apart, as the times of some cameras are whole seconds."""
NOISE_SD = 0.5
"""Standard deviations of the null model that are subtracted from an excess over it, where whatever
may be right is to be kept.
"""
CLEAR_NOISE_SD = 3.0
"""The same for clear excesses only: the initial hazards for prediction, and the screening of views
that may overlap.
"""
FALSE_PROBABILITY = 1e-3
"""Probability that chance alone shows anything of one kind in one window: a silence of a camera, or
a view that overlaps or a long path of any two.
"""
SMOOTHING_SD_BINS = (1.5, 3.0, 6.0)
"""Standard deviations, in lag bins, of the kernels with which histograms of lags are smoothed
before they are compared, as the spread of transit times differs between links.
"""


def poisson_nats(observed: Floats, expected: Floats) -> Floats:
    """Return the evidence (nats) that Poisson counts have higher means than expected, at least 0.

    observed, expected: counts of any one shape; expected above 0.

    It is the log likelihood ratio of the observed count as the mean, n ln(n / e) - (n - e).
    """
    above = np.maximum(observed, expected)
    nats: Floats = above * np.log(above / expected) - (above - expected)
    return nats


def excess_sd(observed: NDArray[Any], expected: NDArray[Any]) -> NDArray[Any]:
    """Return the excess of each Poisson count over its expectation, in standard deviations.

    observed, expected: counts of any one shape.

    The null model has one expected event more: by chance alone, one event where hardly any is
    expected is no excess.
    """
    excess: NDArray[Any] = (observed - expected) / np.sqrt(expected + 1.0)
    return excess


def excess_over_null(observed: Floats, expected: Floats, noise_sd: float) -> Floats:
    """Return by how many counts smoothed lag histograms exceed the null model and its noise.

    observed, expected (P, bins): counts by lag bin, and those expected under the null model.
    noise_sd: standard deviations of the smoothed null model that are subtracted as noise.

    The result is (P, bins), at least 0. This is a cross-correlation (Makris, Ellis and Black 2004)
    at several smoothing widths, of which the largest excess counts.
    """
    result = np.zeros_like(observed)
    for sd_bins in SMOOTHING_SD_BINS:
        spread = lag_smoothing_matrix(observed.shape[1], sd_bins)
        noise = np.sqrt(np.maximum(expected, 0.5) @ (spread**2).T)
        result = np.maximum(result, (observed - expected) @ spread.T - noise_sd * noise)
    return result
