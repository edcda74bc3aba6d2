"""The joint fit: estimate which arrival belongs to which departure, over all zones at once.

The thesis pairs the closest times of two zones (section 4.4), which is wrong as soon as two objects
are between views, and tests each pair of zones alone, which cannot tell A -> C from A -> B -> C.
Here an expectation-maximisation fit (`em`) shares each arrival among its candidates. It goes on
with a sparse prior over pairs of zones (`fit_sparsely`): from the fit for prediction
(`next_camera.fit`), or from nothing (`fit_jointly`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camtopod.arrays import Floats, Singles, row_slices
from camtopod.learn.association.candidates import Candidates
from camtopod.learn.association.em import NOTHING, Em
from camtopod.learn.association.em_model import EmModel
from camtopod.learn.association.problem import Problem
from camtopod.learn.traffic import Persistence

SPARSE_RUNS = 2
"""Runs of EM with the sparse prior."""
SPARSITY = 1.0
"""Transitions that the sparse prior takes off each pair of zones, as most pairs are not linked.
Without the prior, arrivals from outside would be shared out among thousands of pairs.
"""
FOLLOWED_TRANSITIONS_MIN = 0.05
"""Least expected transitions of a pair of zones that is kept for the next run; and least certain
departures of a listed context, and transitions of it to a listed next zone.
"""


class Fit(NamedTuple):
    """Result of a joint fit: M candidates of P pairs of zones."""

    hazard: Singles
    """(P, bins) hazard of each pair of zones by lag, per second and exposed departure, smoothed."""
    counts: Floats
    """(P, bins) expected transitions of each pair of zones by lag."""
    responsibility: Floats
    """(M,) probability that the candidate is of one object."""
    flat: Floats
    """(M,) hazard of the candidate's pair, if it were the same at all lags, over its hazard at the
    candidate's lag.
    """
    outside: Floats
    """(zones,) share of the local rate of arrivals that no departure explains."""
    candidates: Candidates
    """The candidates of the pairs that are kept; defines the order of M and P."""
    persistence: Persistence
    """How far the speed of objects persists from view to view."""


def fit_jointly(problem: Problem, candidates: Candidates) -> Fit:
    """Estimate responsibilities and hazards of all candidates of a problem jointly."""
    em = Em(problem, candidates)
    em.learn_speed(em.run(em.start()))
    return fit_sparsely(em)


def fit_sparsely(em: Em) -> Fit:
    """Go on with a fit with the sparse prior instead of all other additions; return the result.

    After each run, pairs of zones with hardly any transitions and unlikely candidates are dropped.
    """
    em.model = EmModel(sparsity=SPARSITY)
    hazard = em.hazards(em.transitions())
    for _ in range(SPARSE_RUNS):
        hazard = em.run(hazard)
        alive = em.transitions().sum(axis=1) > FOLLOWED_TRANSITIONS_MIN
        hazard = hazard[em.keep(alive[em.candidates.pair] & em.live())]
    return result(em, hazard, em.transitions())


def result(em: Em, hazard: Singles, counts: Floats) -> Fit:
    """Return the result of a fit in progress.

    hazard, counts (P, bins): its hazards and expected transitions.
    """
    return Fit(
        hazard,
        counts,
        em.responsibility.astype(float),
        flatness(em, hazard),
        em.outside,
        em.candidates,
        em.adjustment.persistence,
    )


def flatness(em: Em, hazard: Singles) -> Floats:
    """Return the ratio (M,) of each pair's hazard spread evenly over all lags to its hazard.

    hazard (P, bins): the hazards of the pairs of zones of a fit.

    The ratio is taken for each candidate, at its lag. It is small where the lag speaks for a
    transition, and 1 where the lag says nothing.
    """
    # Hazards (P,) that are the same at every lag and give as many transitions.
    even = np.zeros(em.pairs)
    c = em.candidates
    bins = em.problem.bins
    one_view = em.camera[c.source] == em.camera[c.target]
    before = bins.edges[1:] <= 0
    for rows in row_slices(em.pairs):
        seconds = em.exposure[em.range_of[rows]] * bins.widths
        seconds[one_view[rows, None] & before] = 0.0  # in one view no lag is before the exit
        total = np.maximum(seconds.sum(axis=1), 1e-9)
        even[rows] = (hazard[rows] * seconds).sum(axis=1) / total

    flat: Floats = even[c.pair] / np.maximum(hazard.take(em.adjustment.cell), NOTHING)
    return flat
