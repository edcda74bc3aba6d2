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
    Persistence,
    adjusted_lag,
    agreement,
    label_agreement,
    mean_slowness,
)


class Adjusted(NamedTuple):
    """Result of `adjust` for M candidates.

    persistence: how far speed persists from view to view.
    cell (M,): flat index of each candidate in a table (P, bins) of pairs of zones by lag bin, with
        its lag at usual speed.
    agreement (M,): likelihood ratio of one object by the slownesses and labels before and after;
        None if neither persists.
    likeness (M,): the part of the labels in it; None if they do not persist.
    """

    persistence: Persistence
    cell: Rows
    agreement: Singles | None
    likeness: Singles | None = None

    def take(self, rows: Indices) -> Adjusted:
        """Return the candidates of some rows; pairs of zones keep their numbers."""
        agreement, likeness = (
            None if column is None else column[rows] for column in (self.agreement, self.likeness)
        )
        return Adjusted(self.persistence, self.cell[rows], agreement, likeness)


def adjust(problem: Problem, candidates: Candidates, persistence: Persistence) -> Adjusted:
    """Return the lag bin at usual speed, and the agreement of slownesses, of each candidate.

    persistence: estimate of how far speed persists.
    """
    c = candidates
    bins = problem.bins
    delays = problem.delays(c.source, c.target)
    cell = np.empty(len(c.lag), np.intp)
    agreements = np.empty(len(c.lag), np.float32) if persistence.correlation > 0 else None

    for first in range(0, len(c.lag), CANDIDATES_AT_ONCE):
        part = slice(first, first + CANDIDATES_AT_ONCE)
        lag = c.lag[part].astype(float)
        if persistence.scaling or persistence.correlation:
            slow_before = problem.departures.slow.take(c.departure[part])
            slow_after = problem.arrivals.slow.take(c.arrival[part])
            slow = mean_slowness(slow_before, slow_after)
            lag = adjusted_lag(lag, slow, persistence.scaling)
        in_bins = np.clip(lag - delays[c.pair[part]], bins.lag_min, bins.lag_max)
        cell[part] = c.pair[part] * bins.size + bins.index(in_bins)
        if agreements is not None:
            agreements[part] = agreement(slow_before, slow_after, persistence)

    likeness = likeness_of(problem, candidates, persistence.label)
    if likeness is not None:
        agreements = likeness if agreements is None else agreements * likeness
    return Adjusted(persistence, cell, agreements, likeness)


def likeness_of(problem: Problem, candidates: Candidates, persistence: float) -> Singles | None:
    """Return the agreement of labels (M,) of each candidate; None if there are no labels.

    persistence: share of the objects whose label persists.
    """
    departure_label, arrival_label, share = (
        problem.departures.label,
        problem.arrivals.label,
        problem.arrivals.label_share,
    )
    if departure_label is None or arrival_label is None or share is None or persistence <= 0:
        return None
    c = candidates
    result = np.empty(len(c.lag), np.float32)
    for first in range(0, len(result), CANDIDATES_AT_ONCE):
        part = slice(first, first + CANDIDATES_AT_ONCE)
        arrival = c.arrival[part]
        result[part] = label_agreement(
            departure_label.take(c.departure[part]),
            arrival_label.take(arrival),
            share.take(arrival),
            persistence,
        )
    return result
