"""The joint fit: which arrival belongs to which departure, over all zones at once.

The thesis pairs the closest times of two zones (section 4.4), which is wrong as soon as two objects
are between views, and tests each pair of zones alone, which cannot tell A -> C from A -> B -> C.
Here an expectation-maximisation fit (`em`) shares each arrival among its candidates. Pairs of zones
have a sparse prior, and slowness through a view predicts slowness on the path and in the next
view, as far as the site shows that it does.
"""

from __future__ import annotations

from typing import NamedTuple

from camtopod.arrays import Floats, Singles
from camtopod.learn.association.candidates import Candidates
from camtopod.learn.association.em import Em
from camtopod.learn.traffic import Arrivals, Departures, Persistence
from camtopod.topology import LagBins

SPARSE_ROUNDS_MAX = 4
"""Runs of EM with the sparse prior, at most."""
SETTLED = 0.03
"""Runs end when the persistence of speed changes by less than this."""
SPARSITY = 1.0
"""Transitions taken off each pair of zones, as most pairs are not linked. Without it, thousands of
pairs share the arrivals that come from outside among them."""
FOLLOWED_TRANSITIONS_MIN = 0.05
"""A pair of zones with fewer expected transitions is not followed in later runs."""


class Fit(NamedTuple):
    """Result of a joint fit."""

    hazard: Singles
    """(P, bins) per second and exposed departure, smoothed."""
    counts: Floats
    """(P, bins) expected transitions."""
    responsibility: Floats
    """(M,) probability that the candidate is of one object."""
    flat: Floats
    """(M,) hazard of the pair of zones if it did not depend on the lag, over the hazard."""
    outside: Floats
    """(zones,) share of the local rate of arrivals that no departure explains."""
    candidates: Candidates
    """The candidates still followed, to which ``responsibility`` and the pairs belong."""
    persistence: Persistence


def fit_jointly(
    departures: Departures,
    arrivals: Arrivals,
    candidates: Candidates,
    bins: LagBins,
    zones: int,
    until: float,
) -> Fit:
    """Fit all departures and arrivals up to ``until`` (Unix seconds) jointly, for links.

    Every fit begins from nothing. One that starts from the last believes early mistakes ever more
    and sees too late that a link has opened.
    """
    em = Em(departures, arrivals, candidates, bins, zones, until)

    # First without, then with the sparse prior; pairs of zones without transitions are dropped.
    hazard = em.run(em.learn_speed(em.run(em.start())))
    em.sparsity = SPARSITY
    hazard, counts = prune(em, em.run(hazard))

    # Until the persistence of speed has settled.
    for _ in range(SPARSE_ROUNDS_MAX - 1):
        before = em.persistence
        hazard, counts = prune(em, em.run(em.learn_speed(hazard)))
        changes = (abs(now - then) for now, then in zip(em.persistence, before, strict=True))
        if max(changes) < SETTLED:
            break

    return result(em, hazard, counts)


def prune(em: Em, hazard: Singles) -> tuple[Singles, Floats]:
    """Follow only pairs of zones with transitions; return their hazards and counts (P, bins)."""
    counts = em.transitions()
    alive = counts.sum(axis=1) > FOLLOWED_TRANSITIONS_MIN
    em.keep_pairs(alive)
    return hazard[alive], counts[alive]


def result(em: Em, hazard: Singles, counts: Floats) -> Fit:
    """Return a fit in progress as an immutable `Fit`."""
    return Fit(
        hazard,
        counts,
        em.responsibility.astype(float),
        em.flatness(hazard),
        em.outside,
        em.candidates,
        em.persistence,
    )
