"""A prior over the transitions of pairs of zones, for zones with few departures.

On most sites a path is taken in both directions, by about the same share of objects and in about
the same time, so the transitions from zone v to zone u predict those from u to v. The prior counts
them as transitions of a number of additional departures of each zone, so that they are outweighed
once the zone has many departures of its own. The share of traffic on two-way paths is estimated
from the site: on a one-way site, return traffic is not expected.

`Prior` is a `PairPrior` of the EM fit (`association.em`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Ints
from camtopod.learn.association import Candidates

RETURNING = 10.0
"""Number of additional departures of each zone that go where its arrivals come from, if all paths
are two-way.
"""
TWO_WAY_TRANSITIONS = 20.0
"""Prior weight, in transitions, of the assumption that all paths are two-way."""


class Prior:
    """The prior over the P pairs of zones of a fit.

    candidates: the candidates of the fit, which define its pairs of zones.
    ranges (P,): range of the lags of each pair.
    zones: number of zones.

    back (P,): pair from each pair's target to its source; -1 if there is none, or a long path.
    """

    def __init__(self, candidates: Candidates, ranges: Ints, zones: int) -> None:
        back = _leading_back(candidates, zones)
        short = ranges < zones
        self.back = np.where(short & short[back], back, -1)

    def expected(self, counts: Floats) -> PriorTransitions:
        """Return what the prior adds, given the counted transitions ``counts`` (P, bins)."""
        return PriorTransitions(self, counts)

    def two_way(self, transitions: Floats) -> float:
        """Return the share of all transitions that is matched by transitions in return.

        transitions (P,): number of transitions of each pair.
        """
        returned = np.where(self.back < 0, 0.0, transitions[self.back])
        both = float(np.minimum(transitions, returned).sum())
        return (both + TWO_WAY_TRANSITIONS) / (float(transitions.sum()) + TWO_WAY_TRANSITIONS)


class PriorTransitions:
    """Transitions that the prior adds to pairs of zones, given counted transitions (P, bins).

    departures: number of additional departures of each zone, to which these transitions belong.
    """

    def __init__(self, prior: Prior, counts: Floats) -> None:
        self._back = prior.back
        self.departures = RETURNING * prior.two_way(counts.sum(axis=1))

    def of(self, rows: slice, rates: Callable[[NDArray[np.int64]], Floats]) -> Floats:
        """Return the transitions (pairs, bins) that the prior adds to the pairs ``rows``.

        rates: function from pairs (k,) to the counted transitions per exposed departure (k, bins),
            smoothed.

        They are those that every path would have if it were taken equally in both directions.
        """
        back = self._back[rows]
        by_return: Floats = self.departures * np.where(back[:, None] < 0, 0.0, rates(back))
        return by_return


def _leading_back(candidates: Candidates, zones: int) -> NDArray[np.int64]:
    """Return the pair (P,) that leads from each pair's target back to its source, -1 if none does.

    candidates: define the pairs, which are in order of source, then target.
    """
    source = candidates.source.astype(np.int64)
    target = candidates.target.astype(np.int64)
    there = source * zones + target
    back = target * zones + source
    if len(there) == 0:
        return back
    at = np.minimum(np.searchsorted(there, back), len(there) - 1)
    return np.where(there[at] == back, at, -1)
