"""Histograms as versions carry them: whole steps lose next to nothing, sums and multiples are those
of the masses.
"""

from __future__ import annotations

import msgspec
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from camtopod.records import Histogram
from camtopod.topology.histograms import (
    MASS_MIN,
    STEPS,
    counted,
    counts_added,
    in_steps,
    on_bins,
    scaled,
    steps_added,
)
from camtopod.topology.lag_bins import LagBins

BINS = LagBins(-20.0, 60.0)
Masses = st.lists(st.floats(0.0, 1e6), min_size=BINS.size, max_size=BINS.size).map(np.array)


@given(Masses)
def test_whole_steps_are_as_good_as_the_masses(mass: np.ndarray) -> None:
    back = on_bins(in_steps(mass, BINS), BINS)
    cut = MASS_MIN * mass.sum()  # at the ends
    assert np.abs(back - mass).max() <= max(cut, 0.51 * mass.max() / STEPS)


@given(Masses)
def test_counts_are_told_to_three_digits(counts: np.ndarray) -> None:
    told = counted(counts, BINS)
    assert told.unit == 1.0
    assert np.abs(on_bins(told, BINS) - counts).max() <= max(
        MASS_MIN * counts.sum(), 0.0051 * counts.max()
    )


@given(Masses, Masses, st.floats(0.01, 1.0), st.floats(0.01, 1.0))
def test_sums_and_multiples_are_those_of_the_masses(
    a: np.ndarray, b: np.ndarray, p: float, q: float
) -> None:
    one, other = in_steps(a, BINS), counted(b, BINS)
    wanted = p * on_bins(one, BINS) + q * on_bins(other, BINS)
    both = [(p, one), (q, other)]
    assert np.abs(on_bins(steps_added(both), BINS) - wanted).max() <= 0.51 * wanted.max() / STEPS
    assert counts_added(both).unit == 1.0
    assert np.allclose(on_bins(counts_added(both), BINS), wanted, rtol=0.0051)
    assert np.allclose(on_bins(scaled(one, p), BINS), p * on_bins(one, BINS), rtol=1e-5)


@given(Masses)
def test_a_histogram_added_to_nothing_is_itself(mass: np.ndarray) -> None:
    one, counts = in_steps(mass, BINS), counted(mass, BINS)
    assert steps_added([(1.0, one)]) == one
    assert counts_added([(1.0, counts)]) == counts or not counts.mass
    assert steps_added([]) == counts_added([]) == Histogram(0, [])


@given(Masses)
def test_it_goes_through_both_codes_as_it_is(mass: np.ndarray) -> None:
    for told in (in_steps(mass, BINS), counted(mass, BINS)):
        for code in (msgspec.json, msgspec.msgpack):
            assert repr(code.decode(code.encode(told), type=Histogram)) == repr(told)


def test_one_that_an_older_program_wrote_is_read() -> None:
    old = Histogram(3, [0.5, 12.0])
    assert msgspec.json.decode(b'{"first":3,"mass":[0.5,12.0]}', type=Histogram) == old
    assert on_bins(old, LagBins(0.0, 60.0))[3:5].tolist() == [0.5, 12.0]


def test_what_lies_beyond_the_bins_is_left_out() -> None:
    bins = LagBins(0.0, 60.0)
    assert on_bins(Histogram(-2, [1.0, 2.0, 3.0]), bins)[:2].tolist() == [3.0, 0.0]
    assert on_bins(Histogram(bins.first + bins.size - 1, [4.0, 5.0]), bins)[-1] == 4.0
    assert (
        on_bins(Histogram(500, [1.0]), bins).sum() == on_bins(Histogram(0, []), bins).sum() == 0.0
    )
