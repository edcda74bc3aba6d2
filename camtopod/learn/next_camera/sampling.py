"""Monte Carlo samples of which departure caused each arrival (thesis 4.1; Marinakis, Dudek 2005).

With little data a converged EM fit is overconfident, as it reinforces its own first guesses. A
sampler draws one cause for each arrival (a candidate, or the outside) by the responsibilities,
estimates the hazards as if the draw were the truth, and draws again. The mean over the draws shows
what the events support. `fit.PosteriorFitter.sample` runs the loop; this module draws (`Sources`)
and adds faint transitions to hazards, so that a pair that was not drawn once may be drawn later.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, Indices, Ints, Singles, row_slices
from camtopod.topology import LagBins

FAINT_TRANSITIONS = 0.2
"""Prior transitions of every pair of zones in a sample, spread evenly over the lag bins after the
exit.
"""


class Sources:
    """Draws a cause for each arrival at random: one of its candidates, or the outside.

    arrival (M,): arrival of each candidate, ascending.
    n: number of arrivals.
    seed: of the random numbers.
    """

    def __init__(self, arrival: Indices, n: int, seed: int) -> None:
        self._start = np.searchsorted(arrival, np.arange(n + 1))
        self._random = np.random.default_rng(seed)

    def draw(self, responsibility: Singles) -> Singles:
        """Return 1 for each drawn candidate, at most one an arrival, and 0 for all others, (M,).

        responsibility (M,): probability with which each candidate is drawn.
        """
        reached = np.concatenate(([0.0], np.cumsum(responsibility, dtype=float)))
        before = reached[self._start[:-1]]
        at = np.searchsorted(reached[1:], before + self._random.random(len(before)))
        drawn = np.zeros(len(responsibility), np.float32)
        drawn[at[at < self._start[1:]]] = 1.0
        return drawn


def add_prior_transitions(hazard: Singles, exposed: Floats, source: Ints, bins: LagBins) -> Singles:
    """Add `FAINT_TRANSITIONS` of every pair of zones to its hazard, in place; return the hazards.

    hazard (P, bins): per second and exposed departure.
    exposed (zones, bins): exposed departures, at least 1.
    source (P,): zone of departure of each pair.
    """
    after = bins.edges[1:] > 0
    more = FAINT_TRANSITIONS * np.bincount(source, minlength=len(exposed))
    faint = FAINT_TRANSITIONS * after / (after.sum() * bins.widths)
    for rows in row_slices(len(hazard)):
        exposed_here = exposed[source[rows]]
        zone = source[rows]
        hazard[rows] = (hazard[rows] * exposed_here + faint) / (exposed_here + more[zone][:, None])
    return hazard
