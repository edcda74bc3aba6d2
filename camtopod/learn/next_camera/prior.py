"""A hierarchical prior over the hazards of pairs of zones.

Two things hold on any site. Objects that leave a camera's view take much the same paths, whichever
of its zones they left by. And a path is usually taken in both directions, by about the same share
and in about the same time: when a zone has few departures, the arrivals from another zone say more
about transitions to that zone than the departures do. Both are counted as transitions of a number
of additional departures, so they are outweighed once the zone has enough of its own. The share of
traffic on two-way paths is estimated from the site, so on a one-way site missing return traffic has
no effect.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Singles, row_slices, sum_by_group, table_rows
from camtopod.learn.association import Candidates
from camtopod.topology import smooth

POOLING = 1.0
"""Additional departures of each zone that behave like all departures from its camera's view."""
RETURNING = 10.0
"""Additional departures of each zone that mirror its arrivals if all paths are two-way."""
TWO_WAY_TRANSITIONS = 20.0
"""Prior weight, in transitions, of the assumption that all paths are two-way."""


class Prior:
    """The prior over the pairs of zones of ``candidates``.

    camera (zones,): camera of each zone.
    exposure (zones, bins): departures of each zone that are exposed to a lag bin.
    came (zones,): arrivals of each zone, at least 1.
    """

    def __init__(
        self, candidates: Candidates, camera: NDArray[np.int64], exposure: Floats, came: Floats
    ) -> None:
        cameras = int(camera.max(initial=0)) + 1
        source, target = camera[candidates.source], camera[candidates.target]
        self._views, self.pair = table_rows(source * cameras + target, cameras * cameras)
        self._leaving = self._views // cameras
        self._exposed = np.maximum(sum_by_group(exposure, camera, cameras), 1.0)
        self.share = (came / np.bincount(camera, came)[camera])[candidates.target][:, None]
        self.back = _leading_back(candidates, len(camera))

    def expected(self, counts: Floats) -> PriorTransitions:
        """Return the prior expectation, given the ``counts`` (P, bins) of transitions."""
        return PriorTransitions(self, counts)

    def two_way(self, transitions: Floats) -> float:
        """Return the share of the ``transitions`` (P,) that return traffic matches."""
        returned = np.where(self.back < 0, 0.0, transitions[self.back])
        both = float(np.minimum(transitions, returned).sum())
        return (both + TWO_WAY_TRANSITIONS) / (float(transitions.sum()) + TWO_WAY_TRANSITIONS)

    def pooled(self, counts: Floats) -> Singles:
        """Return transitions per exposed departure from camera to camera, (camera pairs, bins)."""
        seen = sum_by_group(counts, self.pair, len(self._views))
        rates = np.empty(seen.shape, np.float32)
        for rows in row_slices(len(seen)):
            rates[rows] = smooth(seen[rows])[0] / self._exposed[self._leaving[rows]]
        return rates


class PriorTransitions:
    """Transitions that the prior adds to pairs of zones, and the ``departures`` they belong to."""

    def __init__(self, prior: Prior, counts: Floats) -> None:
        self._prior, self._pooled = prior, prior.pooled(counts)
        self._returning = RETURNING * prior.two_way(counts.sum(axis=1))
        self.departures = POOLING + self._returning

    def of(self, rows: slice, rates: Callable[[NDArray[np.int64]], Floats]) -> Floats:
        """Return the expected transitions (rows, bins) of some pairs of zones.

        They are the sum of two terms: transitions if only the cameras mattered, divided among the
        zones by their arrivals; and transitions if every path were taken equally in both
        directions.

        rates: function from pairs (n,) to their observed transitions per exposed departure,
            smoothed.
        """
        back = self._prior.back[rows]
        alike = np.where(back[:, None] < 0, 0.0, rates(back))
        lent = self._pooled[self._prior.pair[rows]] * self._prior.share[rows]
        both: Floats = POOLING * lent + self._returning * alike
        return both


def _leading_back(candidates: Candidates, zones: int) -> NDArray[np.int64]:
    """Return the pair (P,) from each pair's target back to its source, -1 if there is none.

    Pairs come by source, then target.
    """
    source, target = candidates.source.astype(np.int64), candidates.target.astype(np.int64)
    there, back = source * zones + target, target * zones + source
    if len(there) == 0:
        return back
    at = np.minimum(np.searchsorted(there, back), len(there) - 1)
    return np.where(there[at] == back, at, -1)
