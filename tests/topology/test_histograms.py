"""Histograms of versions: rounding loses little, and what is read is what was written."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, strategies as st

from camtopod.records import Histogram
from camtopod.topology.histograms import (
    MASS_MIN,
    STEPS,
    counts_histogram,
    masses_of,
    masses_on_bins,
    step_histograms,
)
from camtopod.topology.lag_bins import LagBins

BINS = LagBins(-20.0, 60.0)
Masses = st.lists(
    st.floats(0.0, 1e6, allow_subnormal=False), min_size=BINS.size, max_size=BINS.size
).map(np.array)


@given(st.lists(Masses, max_size=3))
def test_whole_steps_are_as_good_as_the_masses(rows: list[np.ndarray]) -> None:
    mass = np.array(rows).reshape(-1, BINS.size)
    back = masses_of(step_histograms(mass, BINS), BINS)
    assert back.shape == mass.shape
    for row, told in zip(mass, back, strict=True):
        cut = MASS_MIN * row.sum()  # at the ends
        assert np.abs(told - row).max() <= max(cut, 0.51 * row.max() / STEPS, 1e-37)


def test_histograms_off_the_bins_are_refused() -> None:
    made = step_histograms(np.ones((2, BINS.size)), BINS)
    with pytest.raises(ValueError, match="not on the model's lag bins"):
        masses_of(made, LagBins(-19.0, 60.0))


@given(Masses)
def test_counts_are_told_to_three_digits(counts: np.ndarray) -> None:
    told = counts_histogram(counts, BINS)
    assert told.unit == 1.0
    assert np.abs(masses_on_bins(told, BINS) - counts).max() <= max(
        MASS_MIN * counts.sum(), 0.0051 * counts.max()
    )


def test_one_that_an_older_program_wrote_is_read() -> None:
    old = Histogram(3, [0.5, 12.0])
    assert msgspec.json.decode(b'{"first":3,"mass":[0.5,12.0]}', type=Histogram) == old
    assert masses_on_bins(old, LagBins(0.0, 60.0))[3:5].tolist() == [0.5, 12.0]


def test_what_lies_beyond_the_bins_is_left_out() -> None:
    bins = LagBins(0.0, 60.0)

    assert masses_on_bins(Histogram(-2, [1.0, 2.0, 3.0]), bins)[:2].tolist() == [3.0, 0.0]
    assert masses_on_bins(Histogram(bins.first + bins.size - 1, [4.0, 5.0]), bins)[-1] == 4.0
    assert (
        masses_on_bins(Histogram(500, [1.0]), bins).sum()
        == masses_on_bins(Histogram(0, []), bins).sum()
        == 0.0
    )
