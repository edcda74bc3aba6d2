"""Excess of traffic: by how much arrivals after departures exceed those of unrelated zones."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from camtopod.arrays import Rows, Singles
from camtopod.learn.association.candidates import CANDIDATES_AT_ONCE
from camtopod.learn.association.problem import Problem, exposures
from camtopod.learn.lags import excess_sd
from camtopod.learn.traffic import NullRates

WIDE_BINS = 4
"""Lag bins in a wide bin. Every two wide bins in a row are compared with the null model."""


class Traffic:
    """Compares the arrivals after the departures from every zone with the null model.

    problem: departures and arrivals, not empty.
    """

    def __init__(self, problem: Problem) -> None:
        departures, arrivals, bins, zones, *_ = problem
        self.problem = problem
        self.exposure = exposures(problem)
        """(zones, bins) exposed departures."""
        self.null_model = NullRates(departures.t, departures.zone, arrivals.t, arrivals.zone, zones)

        # Wide bins to which any departure is exposed; one begins at a lag of 0. (zones, wide bins)
        wide = np.unique(np.append(0, np.arange(-bins.first % WIDE_BINS, bins.size, WIDE_BINS)))
        exposure = np.add.reduceat(self.exposure * bins.widths, wide, axis=1).astype(np.float32)
        is_exposed = exposure.any(axis=0)
        self._departure_seconds = exposure[:, is_exposed]
        self._edges = np.append(np.array(bins.limits)[wide[is_exposed]], bins.limits[-1])

        # Departures by part of the window, whose arrivals stay in the processor's cache, and zone.
        # The first arrival after each of them with a lag past each edge.
        group = np.arange(len(departures.t)) // CANDIDATES_AT_ONCE * zones + departures.zone
        by_group = np.argsort(group, kind="stable")
        self._first = np.searchsorted(
            group[by_group], np.arange((len(group) // CANDIDATES_AT_ONCE + 1) * zones + 1)
        )
        self._first_arrivals = [
            np.searchsorted(arrivals.t, np.maximum(departures.since, departures.t + edge))[by_group]
            for edge in self._edges
        ]

        # Camera of each zone; integers that hold the number of candidates of any pair of zones, or
        # its last 32 bits, as differences are exact in these, too.
        self._camera = problem.cameras()
        count_max = np.bincount(departures.zone).max() * np.bincount(arrivals.zone).max()
        self._kind: type = np.uint16 if count_max < 1 << 16 else np.uint32

    def excess(self, targets: Rows) -> Singles:
        """Return by how much the arrivals at k zones exceed the null model, (zones, k).

        targets (k,): the zones of arrival.

        The result is by zone of departure, in standard deviations of the null model at the lags
        with the largest excess (`excess_sd`), and at least 0.
        """
        # For each arrival at any of these zones in turn, the number of earlier ones at each.
        departures, arrivals, _, zones, *_ = self.problem
        column = np.full(zones, -1)
        column[targets] = np.arange(len(targets))
        at = column[arrivals.zone]
        rows = np.flatnonzero(at >= 0)
        number = np.append(0, np.cumsum(at >= 0)).astype(np.int32)
        counts: NDArray[Any] = np.zeros((len(rows) + 1, len(targets)), self._kind)
        counts[np.arange(1, len(counts)), at[rows]] = 1
        np.cumsum(counts, axis=0, dtype=self._kind, out=counts)

        # Arrivals before each edge, added up over the departures from each zone.
        unit_weights: NDArray[Any] = np.ones(len(departures.t), self._kind)
        size = (len(self._first) - 1, len(counts))
        before = [
            (csr_matrix((unit_weights, number.take(first), self._first), shape=size) @ counts)
            .reshape(size[0] // zones, zones, len(targets))
            .sum(axis=0, dtype=self._kind)
            for first in self._first_arrivals
        ]

        # Before the exit, no object is in another view of the same camera.
        rates = self.null_model.rates_to(targets)
        is_same_camera = self._camera[:, None] == self._camera[targets]
        result = np.zeros((zones, len(targets)), np.float32)
        for k, edge in enumerate(self._edges[:-2]):
            expected = rates * self._departure_seconds[:, k : k + 2].sum(axis=1, keepdims=True)
            above = excess_sd(before[k + 2] - before[k], expected)
            if edge < 0:
                above[is_same_camera] = 0.0
            np.maximum(result, above, out=result)
        return result
