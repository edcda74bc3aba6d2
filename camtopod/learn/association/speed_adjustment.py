"""Adjust candidates for speed: an object that is slow in one view takes longer to the next view.

As far as speed persists at the site (`traffic.speed`), the lag of a candidate is scaled to the lag
of an object of usual speed, by the slowness of the passages before its departure and after its
arrival; and a candidate whose two passages are equally slow is likelier to be of one object.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camtopod.arrays import Indices, Rows, Singles
from camtopod.learn.association.candidates import CANDIDATES_AT_ONCE, Candidates
from camtopod.learn.association.problem import Problem
from camtopod.learn.traffic import (
    NO_PERSISTENCE,
    Persistence,
    adjusted_lag,
    agreement,
    mean_slowness,
)


class Adjusted(NamedTuple):
    """Result of `adjust` for M candidates.

    persistence: how far speed persists from view to view.
    cell (M,): flat index of each candidate in a table (P, bins) of pairs of zones by lag bin, with
        its lag at usual speed.
    agreement (M,): likelihood ratio of one object by the slownesses before and after; None if speed
        does not persist.
    """

    persistence: Persistence
    cell: Rows
    agreement: Singles | None

    def take(self, kept: Indices) -> Adjusted:
        """Return the candidates given by their rows ``kept``; pairs of zones keep their numbers."""
        agreement = None if self.agreement is None else self.agreement[kept]
        return Adjusted(self.persistence, self.cell[kept], agreement)


def adjust(problem: Problem, candidates: Candidates, found: Persistence) -> Adjusted:
    """Return the lag bin at usual speed, and the agreement of slownesses, of each candidate.

    found: estimate of how far speed persists.
    """
    c = candidates
    bins = problem.bins
    delays = problem.delays(c.source, c.target)
    cell = np.empty(len(c.lag), np.intp)
    agreements = np.empty(len(c.lag), np.float32) if found.correlation > 0 else None

    for first in range(0, len(c.lag), CANDIDATES_AT_ONCE):
        part = slice(first, first + CANDIDATES_AT_ONCE)
        lag = c.lag[part].astype(float)
        if found != NO_PERSISTENCE:
            slow_before = problem.departures.slow.take(c.departure[part])
            slow_after = problem.arrivals.slow.take(c.arrival[part])
            slow = mean_slowness(slow_before, slow_after)
            lag = adjusted_lag(lag, slow, found.scaling)
        in_bins = np.clip(lag - delays[c.pair[part]], bins.lag_min, bins.lag_max)
        cell[part] = c.pair[part] * bins.size + bins.index(in_bins)
        if agreements is not None:
            agreements[part] = agreement(slow_before, slow_after, found)

    return Adjusted(found, cell, agreements)
