"""Monte Carlo over the sources of arrivals (thesis section 4.1; Marinakis and Dudek 2005).

With little data a converged fit is overconfident, as it reinforces its own first guesses. A sampler
draws one source for each arrival, estimates the hazards as if the draw were the truth, and draws
again; the mean over the draws is what the events support.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, Indices, Ints, Singles, row_slices
from camtopod.topology import LagBins

FAINT_TRANSITIONS = 0.2
"""Prior transitions of every followed pair of zones, spread over the lags after the exit: a pair
that has not been drawn may still be drawn later.
"""


class Sources:
    """Random draws of one source, or the outside, for each of ``n`` arrivals.

    arrival (M,): arrival of each candidate, ascending.
    """

    def __init__(self, arrival: Indices, n: int, seed: int) -> None:
        self._start = np.searchsorted(arrival, np.arange(n + 1))
        self._reached = np.zeros(len(arrival) + 1)
        self._random = np.random.default_rng(seed)

    def draw(self, responsibility: Singles) -> Indices:
        """Return the drawn candidates, ascending.

        responsibility (M,): probability with which each candidate is drawn.
        """
        reached = np.cumsum(responsibility, dtype=float, out=self._reached[1:])
        before = self._reached[self._start[:-1]]
        at = np.searchsorted(reached, before + self._random.random(len(before)))
        drawn: Indices = at[at < self._start[1:]]
        return drawn


def add_prior_transitions(hazard: Singles, exposed: Floats, source: Ints, bins: LagBins) -> Singles:
    """Add the faint transitions of every pair of zones to its hazard, in place, and return it.

    hazard (P, bins): per second and exposed departure.
    exposed (zones, bins): exposed departures, at least 1.
    source (P,): zone of departure of each pair.
    """
    after = bins.edges[1:] > 0
    more = FAINT_TRANSITIONS * np.bincount(source, minlength=len(exposed))
    faint = FAINT_TRANSITIONS * after / (after.sum() * bins.widths)
    for rows in row_slices(len(hazard)):
        here, zone = exposed[source[rows]], source[rows]
        hazard[rows] = (hazard[rows] * here + faint) / (here + more[zone][:, None])
    return hazard
