"""Transit-time histograms over lag bins, as topology versions store them.

The `Histogram` of a link has the number of its first bin, a *count* for each bin from there on
(expected transitions, three significant digits), and a delay in seconds to be added to lags (on
long paths). `Histograms` are those of many rows at once, in *steps*: whole multiples of a unit, at
most `STEPS` per bin. The functions make such histograms and read them.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from camtopod.arrays import Bools, Floats, Rows, Singles
from camtopod.columns import numbers, packed, rounded
from camtopod.records import Histogram, Histograms
from camtopod.topology.lag_bins import LagBins

MASS_MIN = 1e-3
"""Share of the total mass up to which bins at either end of a histogram are left out."""
STEPS = 250
"""Number of steps in the highest bin of a histogram in steps.

They take a byte each: a version has a histogram for each pair of zones that may be linked,
thousands of them.
"""


def counts_histogram(counts: Floats, bins: LagBins, delay: float = 0.0) -> Histogram:
    """Return a histogram of counts, without negligible bins at either end (`MASS_MIN`).

    counts (bins,): expected transitions in each of ``bins``.
    delay (seconds): to be added to the lags.
    """
    [full] = np.nonzero(counts > MASS_MIN * counts.sum())
    if not len(full):
        return Histogram(0, [])
    masses = [float(f"{n:.3g}") for n in counts[full[0] : full[-1] + 1]]
    whole = [int(n) if n.is_integer() else n for n in masses]  # fewer bytes
    histogram = Histogram(bins.first + int(full[0]), whole)
    return replace(histogram, delay=delay) if delay else histogram


def step_histograms(mass: Floats, bins: LagBins) -> Histograms:
    """Return histograms in steps, without negligible bins at either end (`MASS_MIN`).

    mass (n, bins): mass in each of ``bins``, in any unit.
    """
    full = mass > MASS_MIN * mass.sum(axis=1, keepdims=True)
    first = full.argmax(axis=1)
    end = np.where(full.any(axis=1), bins.size - full[:, ::-1].argmax(axis=1), first)
    unit = rounded(mass.max(axis=1, initial=0.0) / STEPS)
    steps = np.rint(mass / np.where(unit > 0.0, unit, 1.0)[:, None])
    return Histograms(
        packed(bins.first + first, np.int16),
        packed(end - first, np.int16),
        packed(unit, np.float32),
        packed(steps[_within(first, end, bins)], np.uint8),
    )


def masses_of(histograms: Histograms, bins: LagBins) -> Singles:
    """Return the masses of n histograms in each of the given bins, (n, bins).

    Raises ValueError for histograms that are not on the bins.
    """
    length = numbers(histograms.bins, np.int16, -1).astype(np.intp)
    first = numbers(histograms.first, np.int16, len(length)).astype(np.intp) - bins.first
    unit = numbers(histograms.unit, np.float32, len(length))
    if ((length < 0) | ((length > 0) & ((first < 0) | (first + length > bins.size)))).any():
        raise ValueError("a histogram is not on the model's lag bins")
    within = _within(first, first + length, bins)
    masses = np.zeros(within.shape, np.float32)
    masses[within] = numbers(histograms.steps, np.uint8, int(length.sum()))
    masses *= unit[:, None]
    return masses


def _within(first: Rows, end: Rows, bins: LagBins) -> Bools:
    """Return a mask (n, bins) of the bins from the first of each row to its end."""
    column = np.arange(bins.size, dtype=np.int16)
    first, end = first.astype(np.int16), end.astype(np.int16)
    return (column >= first[:, None]) & (column < end[:, None])


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


DIGITS = 6
"""Significant digits of figures in a version."""


def round_significant(value: float) -> float:
    """Return a value rounded to `DIGITS` significant digits; -0.0 and nan become 0.0."""
    if math.isnan(value):
        return 0.0
    return float(f"{value:.{DIGITS}g}") + 0.0
