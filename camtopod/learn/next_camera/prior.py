"""What is expected of a pair of zones before anything has been seen there: a hierarchical prior
over the hazards.

Two things are known of any site. What leaves a camera's view goes much the same ways, whichever of
its zones it left by. And a way is as a rule taken in both directions, by about the same share and
in about the same time: of a few departures, what comes back from a zone says more about who goes
there than they do. Both are counted as transitions of so many further departures, so enough of a
zone's own outweigh them. How far ways are taken in both directions is learned from the site: where
traffic goes one way only, nothing is made of what does not come back.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Singles, numbered, rows_together, summed
from camtopod.learn.association import Candidates
from camtopod.topology import smooth

POOLING = 1.0
"""What leaves anywhere in a camera's view counts for each of its zones as much as this many
departures.
"""
RETURNING = 10.0
"""What comes from a zone counts for what goes there as much as this many departures, where all ways
are two-way.
"""
TWO_WAY_TRANSITIONS = 20.0
"""That they are is believed beforehand as much as this many transitions say."""


class Prior:
    """Of the pairs of zones of ``candidates``; ``camera``, ``came`` (zones,): each zone's camera
    and arrivals, at least 1; ``exposure`` (zones, bins).
    """

    def __init__(
        self, candidates: Candidates, camera: NDArray[np.int64], exposure: Floats, came: Floats
    ) -> None:
        cameras = int(camera.max(initial=0)) + 1
        source, target = camera[candidates.source], camera[candidates.target]
        self._views, self.pair = numbered(source * cameras + target, cameras * cameras)
        self._leaving = self._views // cameras
        self._exposed = np.maximum(summed(exposure, camera, cameras), 1.0)
        self.share = (came / np.bincount(camera, came)[camera])[candidates.target][:, None]
        self.back = _leading_back(candidates, len(camera))

    def expected(self, counts: Floats) -> Expected:
        """By the ``counts`` (P, bins) seen."""
        return Expected(self, counts)

    def two_way(self, transitions: Floats) -> float:
        """Share of the ``transitions`` (P,) that as many come back from."""
        returned = np.where(self.back < 0, 0.0, transitions[self.back])
        both = float(np.minimum(transitions, returned).sum())
        return (both + TWO_WAY_TRANSITIONS) / (float(transitions.sum()) + TWO_WAY_TRANSITIONS)

    def pooled(self, counts: Floats) -> Singles:
        """Transitions per exposed departure (views, bins) from camera to camera."""
        seen = summed(counts, self.pair, len(self._views))
        rates = np.empty(seen.shape, np.float32)
        for rows in rows_together(len(seen)):
            rates[rows] = smooth(seen[rows])[0] / self._exposed[self._leaving[rows]]
        return rates


class Expected:
    """Transitions that pairs of zones are expected to have, and of how many ``departures``."""

    def __init__(self, prior: Prior, counts: Floats) -> None:
        self._prior, self._pooled = prior, prior.pooled(counts)
        self._returning = RETURNING * prior.two_way(counts.sum(axis=1))
        self.departures = POOLING + self._returning

    def of(self, rows: slice, rates: Callable[[NDArray[np.int64]], Floats]) -> Floats:
        """Of some pairs of zones (rows, bins): if only the cameras counted, and in them the traffic
        of the zones; and if every way were taken in both directions alike. ``rates``: transitions
        per exposed departure of pairs (n,) as seen, smoothed.
        """
        back = self._prior.back[rows]
        alike = np.where(back[:, None] < 0, 0.0, rates(back))
        lent = self._pooled[self._prior.pair[rows]] * self._prior.share[rows]
        both: Floats = POOLING * lent + self._returning * alike
        return both


def _leading_back(candidates: Candidates, zones: int) -> NDArray[np.int64]:
    """The pair (P,) from each pair's target to its source, -1 if there is none. Pairs come by
    source, then target.
    """
    source, target = candidates.source.astype(np.int64), candidates.target.astype(np.int64)
    there, back = source * zones + target, target * zones + source
    if len(there) == 0:
        return back
    at = np.minimum(np.searchsorted(there, back), len(there) - 1)
    return np.where(there[at] == back, at, -1)
