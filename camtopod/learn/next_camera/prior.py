"""A hierarchical prior over the transitions of pairs of zones, for zones with few departures.

Two things hold on most sites. Objects that leave a camera's view take much the same paths,
whichever of its zones they leave by. And a path is usually taken in both directions, by about the
same share of objects and in about the same time, so the transitions from zone v to zone u predict
those from u to v. The prior counts both as transitions of a number of additional departures of each
zone, so that they are outweighed once the zone has many departures of its own. The share of traffic
on two-way paths is estimated from the site: on a one-way site, return traffic is not expected.

`Prior` is a `PairPrior` of the EM fit (`association.em`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Ints, Singles, row_slices, sum_by_group, table_rows
from camtopod.learn.association import Candidates
from camtopod.topology import smooth

POOLING = 1.0
"""Number of additional departures of each zone that go where departures from its view go."""
RETURNING = 10.0
"""Number of additional departures of each zone that go where its arrivals come from, if all paths
are two-way.
"""
TWO_WAY_TRANSITIONS = 20.0
"""Prior weight, in transitions, of the assumption that all paths are two-way."""


class Prior:
    """The prior over the P pairs of zones of a fit.

    candidates: the candidates of the fit, which define its pairs of zones.
    view (R,): camera of each zone; then of each delayed range of lags a number of its path.
    ranges (P,): range of the lags of each pair.
    exposure (R, bins): exposed departures of each range.
    arrivals (zones,): number of arrivals at each zone, at least 1.

    pair (P,): number of each pair's pair of cameras.
    share (P, 1): share of each pair's target among the arrivals at its camera.
    back (P,): pair from each pair's target to its source; -1 if there is none, or a long path.
    """

    def __init__(
        self,
        candidates: Candidates,
        view: NDArray[np.int64],
        ranges: Ints,
        exposure: Floats,
        arrivals: Floats,
    ) -> None:
        zones = len(arrivals)
        views = int(view.max(initial=0)) + 1
        self._views, self.pair = table_rows(
            view[ranges] * views + view[candidates.target], views * views
        )
        self._leaving = self._views // views
        self._exposed = np.maximum(sum_by_group(exposure, view, views), 1.0)
        camera = view[:zones]
        self.share = (arrivals / np.bincount(camera, arrivals)[camera])[candidates.target][:, None]
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

    def pooled(self, counts: Floats) -> Singles:
        """Return the transitions per exposed departure from camera to camera, (camera pairs, bins).

        counts (P, bins): transitions of each pair of zones.
        """
        counts_by_cameras = sum_by_group(counts, self.pair, len(self._views))
        rates = np.empty(counts_by_cameras.shape, np.float32)
        for rows in row_slices(len(counts_by_cameras)):
            rates[rows] = smooth(counts_by_cameras[rows])[0] / self._exposed[self._leaving[rows]]
        return rates


class PriorTransitions:
    """Transitions that the prior adds to pairs of zones, given counted transitions (P, bins).

    departures: number of additional departures of each zone, to which these transitions belong.
    """

    def __init__(self, prior: Prior, counts: Floats) -> None:
        self._prior, self._pooled = prior, prior.pooled(counts)
        self._returning = RETURNING * prior.two_way(counts.sum(axis=1))
        self.departures = POOLING + self._returning

    def of(self, rows: slice, rates: Callable[[NDArray[np.int64]], Floats]) -> Floats:
        """Return the transitions (pairs, bins) that the prior adds to the pairs ``rows``.

        rates: function from pairs (k,) to the counted transitions per exposed departure (k, bins),
            smoothed.

        They are the sum of two terms: transitions if only the cameras mattered, divided among the
        zones by their arrivals; and transitions if every path were taken equally in both
        directions.
        """
        back = self._prior.back[rows]
        by_return = np.where(back[:, None] < 0, 0.0, rates(back))
        by_cameras = self._pooled[self._prior.pair[rows]] * self._prior.share[rows]
        both: Floats = POOLING * by_cameras + self._returning * by_return
        return both


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
