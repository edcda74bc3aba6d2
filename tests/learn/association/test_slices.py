"""A fit works on some candidates and some pairs of zones at a time: that takes less memory and
changes no bit.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from synthetic_events import Views, fit_posterior

from camtopod.arrays import ROWS_AT_ONCE, row_slices
from camtopod.learn.association import candidates as module
from camtopod.learn.association.candidates import find_candidates, slices_by_arrival
from camtopod.learn.association.em import Em
from camtopod.learn.association.problem import Problem
from camtopod.learn.association.speed_adjustment import adjust
from camtopod.learn.traffic.speed import Persistence
from camtopod.topology.lag_bins import LagBins

BINS = LagBins(-20.0, 60.0)


@given(st.lists(st.integers(0, 30), max_size=100).map(sorted), st.integers(1, 40))
def test_candidates_of_an_arrival_are_worked_on_together(arrival: list[int], at_once: int) -> None:
    with pytest.MonkeyPatch.context() as limits:
        limits.setattr(module, "CANDIDATES_AT_ONCE", at_once)
        parts = slices_by_arrival(np.array(arrival, np.int32))
    assert [row for part in parts for row in range(part.start, part.stop)] == list(
        range(len(arrival))
    )
    assert sum(len({*arrival[part]}) for part in parts) == len({*arrival})
    assert all(
        part.stop - part.start < at_once + arrival.count(arrival[part.stop - 1]) for part in parts
    )


@given(st.integers(0, 5000))
def test_of_rows_no_few_are_left_over(rows: int) -> None:
    parts = list(row_slices(rows))
    assert [row for part in parts for row in range(part.start, part.stop)] == list(range(rows))
    assert all(part.stop - part.start >= min(rows, ROWS_AT_ONCE) for part in parts)


def walks() -> Views:
    """Return traffic in which most go from zone 0 to zone 1, beside unrelated traffic at zone 2."""
    rng = np.random.default_rng(2)
    views = Views([0, 1, 2])
    for t in rng.uniform(0, 3_200, 160):
        views.through(t, t + rng.uniform(3, 5), 0, 0)
        if rng.random() < 0.6:
            came = views.rows[-1][1] + rng.normal(8, 1)
            views.through(came, came + rng.uniform(3, 5), 1, 1)
    for t in rng.uniform(0, 3_200, 80):
        views.through(t, t + rng.uniform(3, 5), 2, 2)
    return views


def test_no_part_of_a_fit_differs() -> None:
    departures, arrivals = walks().columns()
    rng = np.random.default_rng(5)
    departures = departures._replace(slow=rng.normal(size=len(departures.t)))
    arrivals = arrivals._replace(slow=rng.normal(size=len(arrivals.t)))
    problem = Problem(departures, arrivals, BINS, 3, 3_200.0)
    results = []
    for at_once in (100_000, 50):
        with pytest.MonkeyPatch.context() as limits:
            limits.setattr(module, "CANDIDATES_AT_ONCE", at_once)
            found = find_candidates(problem)
            adjusted = adjust(problem, found, Persistence(0.5, 0.6, 1.0))
            fitter = Em(problem, found, adjusted=adjusted)
            hazard = fitter.run(fitter.start())
            joint = (
                *found,
                hazard,
                fitter.transitions(),
                fitter.responsibility,
                fitter.outside,
                fitter.flatness(hazard),
            )
            posterior = fit_posterior(problem)
            results.append((*joint, *posterior.fit[:5], *posterior[1:-1]))
    whole, parts = results
    assert all(np.array_equal(one, other) for one, other in zip(whole, parts, strict=True))
