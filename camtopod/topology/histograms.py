"""Transit-time histograms over lag bins, as topology versions store them.

A `Histogram` has the number of its first bin, a mass for each bin from there on, a unit by which
masses are multiplied, and a delay in seconds to be added to lags (on long paths). Masses are either
*counts* (expected transitions, three significant digits) or *steps* (whole multiples of the unit,
at most `STEPS` per bin). The functions make such histograms and read them.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from camtopod.arrays import Floats
from camtopod.records import Histogram
from camtopod.topology.lag_bins import LagBins

MASS_MIN = 1e-3
"""Share of the total mass up to which bins at either end of a histogram are left out."""
STEPS = 250
"""Number of steps in the highest bin of a histogram in steps.

A version has a histogram for each pair of zones that may be linked, thousands of them. Integers of
this size take one or two bytes in a message and no memory of their own in Python.
"""


def counts_histogram(counts: Floats, bins: LagBins, delay: float = 0.0) -> Histogram:
    """Return a histogram of counts, without negligible bins at either end (`MASS_MIN`).

    counts (bins,): expected transitions in each of ``bins``.
    delay (seconds): to be added to the lags.
    """
    first, values = _trimmed(counts, bins)
    if not len(values):
        return Histogram(0, [])
    return _delayed(Histogram(first, [float(f"{n:.3g}") for n in values]), delay)


def step_histogram(mass: Floats, bins: LagBins, delay: float = 0.0) -> Histogram:
    """Return a histogram in steps, without negligible bins at either end (`MASS_MIN`).

    mass (bins,): mass in each of ``bins``, in any unit.
    delay (seconds): to be added to the lags.
    """
    first, values = _trimmed(mass, bins)
    unit = round_significant(float(values.max(initial=0.0)) / STEPS)
    if unit == 0.0:
        return Histogram(0, [])
    steps = np.rint(values / unit).astype(np.int64).tolist()
    return _delayed(Histogram(first, steps, unit), delay)


def masses_on_bins(histogram: Histogram, bins: LagBins) -> Floats:
    """Return the mass of a histogram in each of the given bins, (bins,).

    Mass outside the bins is dropped; the histogram's delay is not applied.
    """
    result = np.zeros(bins.size)
    start = histogram.first - bins.first
    low = max(-start, 0)
    high = min(bins.size - start, len(histogram.mass))
    if low < high:
        result[start + low : start + high] = histogram.mass[low:high]
        result *= histogram.unit
    return result


def _delayed(histogram: Histogram, delay: float) -> Histogram:
    """Return a histogram with its delay (seconds); without one the field is left out."""
    if delay == 0.0:
        return histogram
    return replace(histogram, delay=delay)


def _trimmed(mass: Floats, bins: LagBins) -> tuple[int, Floats]:
    """Return the number of the first bin that is kept, and the masses from there on."""
    full = np.flatnonzero(mass > MASS_MIN * mass.sum())
    if not len(full):
        return 0, mass[:0]
    return bins.first + int(full[0]), mass[full[0] : full[-1] + 1]


DIGITS = 6
"""Significant digits of figures in a version, and decimals of its chain."""


def round_significant(value: float) -> float:
    """Return a value rounded to `DIGITS` significant digits; -0.0 and nan become 0.0."""
    if math.isnan(value):
        return 0.0
    return float(f"{value:.{DIGITS}g}") + 0.0
