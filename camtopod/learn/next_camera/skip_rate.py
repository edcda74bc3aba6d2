"""Which candidates may have skipped a view, and how often views are skipped.

Of ten thousand pairs of zones some hundred are ends of ways over a skipped view (`skipped`), and of
the candidates one in ten may have taken such a way: only of these anything is kept.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from camtopod.arrays import Floats, Indices, Ints, Longs, Singles
from camtopod.learn.association import Candidates
from camtopod.topology import LagBins

ODDS_FIRST, ODDS_MAX = 0.1, 2.0 / 3.0
"""Passages that a camera misses for each that it records."""
ODDS_PASSAGES = 20.0
"""The first odds count as much as this many passages recorded on ways that may be skipped."""


class Skipping:
    """The candidates that may have skipped a view, and the hazards of that."""

    def __init__(self, bins: LagBins) -> None:
        self._bins = bins
        self.odds = ODDS_FIRST
        """Passages missed for each that is recorded, which all views have in common."""
        self.pair: Longs = np.zeros(0, np.int64)
        """(K,) the pairs of zones over a skipped view, ascending."""
        self._unit = np.zeros((0, bins.size), np.float32)  # hazards (K, bins) of them at odds of 1
        self.some: Indices = np.zeros(0, np.int32)
        """(s,) the candidates, ascending."""
        self._cell: Ints = np.zeros(0, np.int32)  # place of each in the table
        self.part: Singles = np.zeros(0, np.float32)
        """(s,) share of what speaks for each that is the skipped view's."""

    def use(
        self, pair: Longs, unit: Floats, candidates: Candidates, cell: Ints, parts: Sequence[slice]
    ) -> None:
        """From here on the hazards ``unit`` (K, bins) of `skip_hazards`; ``cell`` (M,): place of
        each candidate in a table (P, bins).
        """
        self.pair, self._unit = pair, unit.astype(np.float32)
        row = np.full(len(candidates.source), -1, np.int32)
        row[pair] = np.arange(len(pair), dtype=np.int32)
        some, cells = [np.zeros(0, np.int32)], [np.zeros(0, np.int32)]
        for part in parts:
            of = candidates.pair[part]
            here = np.flatnonzero(row.take(of) >= 0)
            of = of[here]
            at = cell[part][here] + (row.take(of) - of) * self._bins.size
            occurs = self._unit.take(at) > 0
            some.append((here[occurs] + part.start).astype(np.int32))
            cells.append(at[occurs])
        self.some, self._cell = np.concatenate(some), np.concatenate(cells)
        self.part = np.zeros(len(self.some), np.float32)

    def believe(self, some: Indices, part: Singles) -> None:
        """In the end: of which candidates what share is the skipped view's."""
        self.some, self.part, self._cell = some, part, np.zeros(0, np.int32)

    def hazard(self, here: slice) -> Singles:
        """Of some of the candidates, by the odds."""
        hazard: Singles = self.odds * self._unit.take(self._cell[here])
        return hazard

    def added(self, hazard: Singles, rows: slice) -> Singles:
        """Hazards (rows, bins) of some pairs of zones and of skipped views together."""
        here = slice(*np.searchsorted(self.pair, (rows.start, rows.stop)).tolist())
        if here.start == here.stop:
            return hazard
        both = hazard.copy()
        both[self.pair[here] - rows.start] += self.odds * self._unit[here]
        return both

    def learn(self, responsibility: Singles, left: Floats) -> None:
        """M step of the odds; ``responsibility`` (M,) of all candidates, ``left`` (P,) departures
        at the sources.
        """
        recorded = float(self._unit @ self._bins.widths @ left[self.pair])
        skipped = float(responsibility[self.some].astype(float) @ self.part)
        odds = (skipped + ODDS_FIRST * ODDS_PASSAGES) / (recorded + ODDS_PASSAGES)
        self.odds = min(odds, ODDS_MAX)
