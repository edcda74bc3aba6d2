"""Estimate how often cameras miss passages, and which candidates may have skipped a camera.

As a `Term` of the EM fit (`association.em`), `SkippedCameras` gives candidates the rate of
appearing after a skipped camera: the hazard at odds of 1, computed by `skipped_cameras`, times the
odds of a missed passage, which are estimated here.

Of ten thousand pairs of zones a hundred or so are joined by a path over a skipped camera, and one
in ten of the candidates may have taken such a path. Data are kept for these only.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, Indices, Longs, Rows, Singles
from camtopod.learn.association import Candidates
from camtopod.topology import LagBins

ODDS_FIRST = 0.1
ODDS_MAX = 2.0 / 3.0
"""Odds of a missed passage (missed passages for each recorded one): first estimate, upper limit."""
ODDS_PASSAGES = 20.0
"""Weight of the first estimate, in passages recorded on paths that may be skipped."""


class SkippedCameras:
    """The s candidates and K pairs of zones that may have skipped a camera, and their hazards."""

    def __init__(self, bins: LagBins, left: Floats, odds: float = ODDS_FIRST) -> None:
        """Begin without any path over a skipped camera.

        bins: bins of the lags.
        left (P,): number of departures at the source of each pair of zones of the fit.
        """
        self._bins = bins
        self._left = left
        self.odds = odds
        """Missed passages for each recorded one, the same for all cameras."""
        self.pair: Longs = np.zeros(0, np.int64)
        """(K,) pairs of zones that a path over a skipped camera joins, ascending."""
        # (K, bins) hazards of these pairs at odds of 1.
        self._unit = np.zeros((0, bins.size), np.float32)
        self.rows: Indices = np.zeros(0, np.int32)
        """(s,) rows of the candidates that may have skipped a camera, ascending."""
        # (s,) index of each of these candidates in the flattened table (K, bins).
        self._cell: Rows = np.zeros(0, np.intp)
        self.share: Singles = np.zeros(0, np.float32)
        """(s,) share of each candidate's rate that skipped cameras contribute."""

    def use(self, pair: Longs, unit: Floats, candidates: Candidates, cell: Rows) -> None:
        """Replace the hazards of skipped cameras, and select the candidates that they apply to.

        pair (K,): pairs of zones that paths over skipped cameras join, ascending.
        unit (K, bins): hazards of these pairs at odds of 1 (`skip_hazards`).
        candidates: all candidates of the fit.
        cell (M,): flat index of each candidate in a table (P, bins) of pairs of zones by lag bin.
        """
        self.pair = pair
        self._unit = unit.astype(np.float32)
        row = np.full(len(candidates.source), -1, np.int32)
        row[pair] = np.arange(len(pair), dtype=np.int32)

        # Candidates of these pairs whose lag a path over a skipped camera can have.
        joined = np.flatnonzero(row.take(candidates.pair) >= 0).astype(np.int32)
        of = candidates.pair[joined]
        at = cell[joined] + (row.take(of) - of) * self._bins.size
        occurs = self._unit.take(at) > 0
        self.rows = joined[occurs]
        self._cell = at[occurs]
        self.share = np.zeros(len(self.rows), np.float32)

    def believe(self, rows: Indices, share: Singles) -> None:
        """Set the final candidates (s,), and the share (s,) that skipped cameras have in each."""
        self.rows = rows
        self.share = share
        self._cell = np.zeros(0, np.intp)

    def rates(self, responsibility: Singles) -> Singles:
        """Return the rates (s,) of the candidates at the present odds of a missed passage.

        The hazards come from other pairs of zones, so no candidate contributes to its own rate, and
        the responsibilities are not needed.
        """
        rates: Singles = self.odds * self._unit.take(self._cell)
        return rates

    def after_exit(self, hazard: Singles, rows: slice) -> Singles:
        """Return the hazards (pairs, bins) of the pairs ``rows`` with skipped cameras added."""
        here = slice(*np.searchsorted(self.pair, (rows.start, rows.stop)).tolist())
        if here.start == here.stop:
            return hazard
        both = hazard.copy()
        both[self.pair[here] - rows.start] += self.odds * self._unit[here]
        return both

    def learn(self, responsibility: Singles) -> None:
        """Do the M step: estimate the odds by the responsibilities (M,) of all candidates.

        The odds are the expected transitions over skipped cameras, over the passages recorded on
        the same paths.
        """
        recorded = float(self._unit @ self._bins.widths @ self._left[self.pair])
        skipped = float(responsibility[self.rows].astype(float) @ self.share)
        odds = (skipped + ODDS_FIRST * ODDS_PASSAGES) / (recorded + ODDS_PASSAGES)
        self.odds = min(odds, ODDS_MAX)
