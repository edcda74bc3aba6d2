"""A prior over the transitions of pairs of zones, for zones with few departures.

On most sites a path is taken in both directions, by about the same share of objects and in about
the same time, so the transitions from zone v to zone u predict those from u to v. The prior counts
them as transitions of a number of additional departures of each zone, so that they are outweighed
once the zone has many departures of its own. The share of traffic on two-way paths is estimated
from the site: on a one-way site, return traffic is not expected.

`Prior` is a `PairPrior` of the EM fit (`association.em`).
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, Ints, find_pairs
from camtopod.learn.association import Candidates

RETURNING = 10.0
"""Number of additional departures of each zone that go where its arrivals come from, if all paths
are two-way; and weight, in transitions, of the assumption that they are.
"""


class Prior:
    """The prior over the P pairs of zones of a fit.

    candidates: the candidates of the fit, which define its pairs of zones.
    ranges (P,): range of the lags of each pair.
    zones: number of zones.

    back (P,): pair from each pair's target to its source; -1 if there is none, or a long path.
    """

    def __init__(self, candidates: Candidates, ranges: Ints, zones: int) -> None:
        source, target = candidates.source, candidates.target
        back, exists = find_pairs((source, target), (target, source))
        short = ranges < zones
        self.back = np.where(exists & short & short[back], back, -1)

    def departures(self, transitions: Floats) -> float:
        """Return the number of additional departures of each zone.

        transitions (P,): number of transitions of each pair.

        It depends on the share of all transitions that is matched by transitions in return.
        """
        return_transitions = np.where(self.back < 0, 0.0, transitions[self.back])
        round_trips = float(np.minimum(transitions, return_transitions).sum())
        total = float(transitions.sum())
        return RETURNING * (round_trips + RETURNING) / (total + RETURNING)
