"""Monte Carlo over who came from where (thesis section 4.1; Marinakis and Dudek 2005 sample the
same).

Where there is little to go by, a fit that has settled is surer than it may be: it believes in its
own first guesses. A sampler draws one source for each arrival, learns from the draw as if it were
the truth, and draws again; what it believes on average is what the events say.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, Indices, Ints, Singles, rows_together
from camtopod.topology import LagBins

FAINT_TRANSITIONS = 0.2
"""Every pair of zones that is followed has this many transitions beforehand, at any lag after the
exit: what has not been drawn may still happen.
"""


class Sources:
    """Draws of one source, or the outside, for each of ``n`` arrivals; ``arrival`` (M,) is that of
    each candidate, ascending.
    """

    def __init__(self, arrival: Indices, n: int, seed: int) -> None:
        self._start = np.searchsorted(arrival, np.arange(n + 1))
        self._reached = np.zeros(len(arrival) + 1)
        self._random = np.random.default_rng(seed)

    def draw(self, responsibility: Singles) -> Indices:
        """The candidates that are drawn, ascending, of all (M,) with these probabilities."""
        reached = np.cumsum(responsibility, dtype=float, out=self._reached[1:])
        before = self._reached[self._start[:-1]]
        at = np.searchsorted(reached, before + self._random.random(len(before)))
        drawn: Indices = at[at < self._start[1:]]
        return drawn


def with_faint(hazard: Singles, exposed: Floats, source: Ints, bins: LagBins) -> Singles:
    """Hazards (P, bins) as they are with the faint transitions that every pair has, in the place of
    those without; ``exposed`` (zones, bins) departures, at least 1, ``source`` (P,).
    """
    after = bins.edges[1:] > 0
    more = FAINT_TRANSITIONS * np.bincount(source, minlength=len(exposed))
    faint = FAINT_TRANSITIONS * after / (after.sum() * bins.widths)
    for rows in rows_together(len(hazard)):
        here, zone = exposed[source[rows]], source[rows]
        hazard[rows] = (hazard[rows] * here + faint) / (here + more[zone][:, None])
    return hazard
