"""Histograms over lag bins as versions carry them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from msgspec.structs import replace

from camtopod.arrays import Floats
from camtopod.records import Histogram
from camtopod.topology.lag_bins import LagBins

Weighed = tuple[float, Histogram]

MASS_MIN = 1e-3
"""Bins at the ends with less than this share of the mass are left off."""
STEPS = 250
"""Of the highest bin, where a histogram is in whole steps: a version has one for each pair of zones
that may be linked, thousands of them. Whole numbers this small take a byte or two in a message and
none of their own in Python.
"""


def counted(counts: Floats, bins: LagBins, delay: float = 0.0) -> Histogram:
    """Expected transitions per lag bin (bins,); ``delay``: seconds to add to the lags."""
    first, last = _ends(counts)
    if first == last:
        return Histogram(0, [])
    return _late(Histogram(bins.first + first, _three_digits(counts[first:last])), delay)


def in_steps(mass: Floats, bins: LagBins, delay: float = 0.0) -> Histogram:
    """Masses (bins,) in whole steps; ``delay``: seconds to add to the lags."""
    first, last = _ends(mass)
    return _late(_stepped(bins.first + first, mass[first:last]), delay)


def scaled(histogram: Histogram, factor: float) -> Histogram:
    """A histogram times a factor."""
    return replace(histogram, unit=short(histogram.unit * factor))


def counts_added(histograms: Iterable[Weighed]) -> Histogram:
    """The weighted sum of counts."""
    first, counts, delay = _sum(histograms)
    return _late(Histogram(first, _three_digits(counts)), delay)


def steps_added(histograms: Iterable[Weighed]) -> Histogram:
    """The weighted sum of histograms, in whole steps."""
    first, mass, delay = _sum(histograms)
    return _late(_stepped(first, mass), delay)


def on_bins(histogram: Histogram, bins: LagBins) -> Floats:
    """Masses on all of the bins, (bins,); what lies beyond them is left out."""
    result = np.zeros(bins.size)
    start = histogram.first - bins.first
    low, high = max(-start, 0), min(bins.size - start, len(histogram.mass))
    if low < high:
        result[start + low : start + high] = histogram.mass[low:high]
        result *= histogram.unit
    return result


def _sum(histograms: Iterable[Weighed]) -> tuple[int, Floats, float]:
    """First bin, masses and delay; of histograms with different delays those with the delay of the
    heaviest.
    """
    known = [(weight, one) for weight, one in histograms if one.mass]
    if not known:
        return 0, np.zeros(0), 0.0
    delay = max(known, key=lambda each: each[0] * each[1].unit * sum(each[1].mass))[1].delay
    known = [(weight, one) for weight, one in known if one.delay == delay]
    first = min(one.first for _, one in known)
    mass = np.zeros(max(one.first + len(one.mass) for _, one in known) - first)
    for weight, one in known:
        mass[one.first - first :][: len(one.mass)] += (
            weight * one.unit * np.array(one.mass, np.float64)
        )
    return first, mass, delay


def _ends(mass: Floats) -> tuple[int, int]:
    """First and last-but-one bin that counts."""
    full = np.flatnonzero(mass > MASS_MIN * mass.sum())
    return (int(full[0]), int(full[-1]) + 1) if len(full) else (0, 0)


def _stepped(first: int, mass: Floats) -> Histogram:
    unit = short(float(mass.max(initial=0.0)) / STEPS)
    if unit == 0.0:
        return Histogram(0, [])
    return Histogram(first, np.rint(mass / unit).astype(np.int64).tolist(), unit)


def _late(histogram: Histogram, delay: float) -> Histogram:
    """The histogram with seconds to add to its lags, which it does not mention where there are
    none.
    """
    return replace(histogram, delay=delay) if delay and histogram.mass else histogram


def _three_digits(counts: Floats) -> list[int | float]:
    return [float(f"{n:.3g}") for n in counts]


DIGITS = 6


def short(value: float) -> float:
    """Six significant digits; minus zero and nan become zero."""
    return float(f"{value:.{DIGITS}g}") + 0.0 if value == value else 0.0
