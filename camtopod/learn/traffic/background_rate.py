"""Local rates: how often arrivals come at a zone around a moment, whatever the reason.

A null with a constant rate takes a common rhythm (day and night) for links; a local one does not.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Singles, rows_of

"""Of numbers of events, which are exact in it."""

RATE_HALF_WINDOW_SECONDS = 600.0
RATE_PRIOR_EVENTS = 2.0
"""The mean rate of the zone counts as much as this many events."""
CHANCE_BIN_SECONDS = 300.0
TABLE_ZONES_MAX = 2000
"""Of so many zones the rates of all pairs are worked out at once (32 MB); of more, those asked for
...
"""
PAIRS_AT_ONCE = 500
"""... so many at a time."""


def local_rates(t: Floats, zone: NDArray[np.int32], zones: int) -> Floats:
    """Rate (1/s) at each arrival's own zone within ten minutes of it, itself left out; ``t`` (n,)
    ascending, in s.
    """
    rates = np.zeros(len(t))
    if len(t) == 0:
        return rates
    first, last = t[0], t[-1]
    for here in rows_of(zone, zones):
        if len(here) == 0:
            continue
        own = t[here]
        low, high = own - RATE_HALF_WINDOW_SECONDS, own + RATE_HALF_WINDOW_SECONDS
        others = np.searchsorted(own, high, "right") - np.searchsorted(own, low, "left") - 1
        span = np.minimum(high, last) - np.maximum(low, first)
        mean = len(own) / max(last - first, 1.0)
        rates[here] = (others + RATE_PRIOR_EVENTS) / (span + RATE_PRIOR_EVENTS / mean)
    return rates


class Chance:
    """Arrivals per second at a zone around a departure from another if they have nothing to do with
    each other.

    Both are counted in bins of some minutes, so a rhythm common to all zones is part of chance.
    Times (n,) ascend, are in seconds and are not none.
    """

    def __init__(
        self,
        left_t: Floats,
        left_zone: NDArray[np.int32],
        came_t: Floats,
        came_zone: NDArray[np.int32],
        zones: int,
    ) -> None:
        first = min(left_t[0], came_t[0])
        n = int((max(left_t[-1], came_t[-1]) - first) // CHANCE_BIN_SECONDS) + 1
        self._left = _per_bin(left_t, left_zone, first, n, zones)
        came = _per_bin(came_t, came_zone, first, n, zones)
        self._around = np.copy(came)
        self._around[:, 1:] += came[:, :-1]
        self._around[:, :-1] += came[:, 1:]
        bins = np.full(n, 3.0)
        bins[0] -= 1.0
        bins[-1] -= 1.0
        self._seconds = CHANCE_BIN_SECONDS * np.maximum(bins, 1.0)
        self._number = np.maximum(self._left.sum(axis=1, dtype=float), 1.0)
        self._table = None
        if zones <= TABLE_ZONES_MAX:
            rate = self._around / self._seconds
            self._table = (self._left.astype(float) @ rate.T) / self._number[:, None]

    def of(
        self, source: NDArray[np.signedinteger[Any]], target: NDArray[np.signedinteger[Any]]
    ) -> Floats:
        """Rates (P,) in 1/s at zones ``target`` (P,) around departures from ``source`` (P,)."""
        if self._table is not None:
            known: Floats = self._table[source, target]
            return known
        rates: Floats = np.zeros(len(source))
        for k in range(0, len(source), PAIRS_AT_ONCE):
            some = slice(k, k + PAIRS_AT_ONCE)
            left, rate = (
                self._left[source[some]].astype(float),
                self._around[target[some]] / self._seconds,
            )
            rates[some] = np.einsum("pn,pn->p", left, rate)
        rates /= self._number[source]
        return rates


def _per_bin(t: Floats, zone: NDArray[np.int32], first: float, n: int, zones: int) -> Singles:
    """Events in each of ``n`` bins of time from ``first`` on, (zones, n)."""
    when = ((t - first) // CHANCE_BIN_SECONDS).astype(np.int64)
    events = np.zeros(zones * n, np.float32)
    np.add.at(events, zone.astype(np.int64) * n + when, 1.0)
    return events.reshape(zones, n)
