"""Estimate how often cameras miss passages, and which candidates may have skipped a camera.

Of ten thousand pairs of zones a hundred or so are joined by a path over a skipped camera
(`skipped_cameras`), and one in ten of the candidates may have taken such a path. Data are kept for
these only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from camtopod.arrays import Floats, Indices, Ints, Longs, Singles
from camtopod.learn.association import Candidates
from camtopod.topology import LagBins

ODDS_FIRST, ODDS_MAX = 0.1, 2.0 / 3.0
"""Missed passages for each recorded one: first estimate, and upper limit."""
ODDS_PASSAGES = 20.0
"""Weight of the first estimate, in passages recorded on paths that may be skipped."""


class SkippedCameras:
    """Candidates that may have skipped a camera, and the hazards of that."""

    def __init__(self, bins: LagBins, left: Floats) -> None:
        """Begin with no path over a skipped camera.

        left (P,): departures at the source of each pair of zones.
        """
        self._bins, self._left = bins, left
        self.odds = ODDS_FIRST
        """Missed passages for each recorded one, the same for all cameras."""
        self.pair: Longs = np.zeros(0, np.int64)
        """(K,) pairs of zones that a path over a skipped camera joins, ascending."""
        self._unit = np.zeros((0, bins.size), np.float32)  # (K, bins) their hazards at odds of 1
        self.rows: Indices = np.zeros(0, np.int32)
        """(s,) candidates that may have skipped a camera, ascending."""
        self._cell: Ints = np.zeros(0, np.int32)  # (s,) index of each in the flattened table
        self.share: Singles = np.zeros(0, np.float32)
        """(s,) share of each candidate's hazard that skipped cameras contribute."""

    def use(
        self, pair: Longs, unit: Floats, candidates: Candidates, cell: Ints, parts: Sequence[slice]
    ) -> None:
        """Use new hazards of skipped cameras from here on.

        pair (K,): pairs of zones, ascending.
        unit (K, bins): hazards at odds of 1 (`skip_hazards`).
        cell (M,): index of each candidate in a flattened table (P, bins).
        parts: slices of the candidates, worked on one at a time.
        """
        self.pair, self._unit = pair, unit.astype(np.float32)
        row = np.full(len(candidates.source), -1, np.int32)
        row[pair] = np.arange(len(pair), dtype=np.int32)

        # Candidates of these pairs whose lag a path over a skipped camera can have.
        some, cells = [np.zeros(0, np.int32)], [np.zeros(0, np.int32)]
        for part in parts:
            of = candidates.pair[part]
            here = np.flatnonzero(row.take(of) >= 0)
            of = of[here]
            at = cell[part][here] + (row.take(of) - of) * self._bins.size
            occurs = self._unit.take(at) > 0
            some.append((here[occurs] + part.start).astype(np.int32))
            cells.append(at[occurs])
        self.rows, self._cell = np.concatenate(some), np.concatenate(cells)
        self.share = np.zeros(len(self.rows), np.float32)

    def believe(self, rows: Indices, share: Singles) -> None:
        """Set the final candidates (s,) and the share (s,) of skipped cameras in each."""
        self.rows, self.share, self._cell = rows, share, np.zeros(0, np.int32)

    def rates(self, here: slice, responsibility: Singles) -> Singles:
        """Return the hazards of some candidates at the current odds of a missed passage.

        The hazards come from other pairs of zones, so no candidate contributes to its own, and
        the responsibilities are not needed.

        here: slice of `rows`.
        """
        rates: Singles = self.odds * self._unit.take(self._cell[here])
        return rates

    def after_exit(self, hazard: Singles, rows: slice) -> Singles:
        """Return the hazards (rows, bins) of some pairs of zones, skipped cameras included."""
        here = slice(*np.searchsorted(self.pair, (rows.start, rows.stop)).tolist())
        if here.start == here.stop:
            return hazard
        both = hazard.copy()
        both[self.pair[here] - rows.start] += self.odds * self._unit[here]
        return both

    def learn(self, responsibility: Singles) -> None:
        """M step: estimate the odds by the responsibilities (M,) of all candidates."""
        recorded = float(self._unit @ self._bins.widths @ self._left[self.pair])
        skipped = float(responsibility[self.rows].astype(float) @ self.share)
        odds = (skipped + ODDS_FIRST * ODDS_PASSAGES) / (recorded + ODDS_PASSAGES)
        self.odds = min(odds, ODDS_MAX)
