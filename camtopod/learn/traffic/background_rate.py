"""Local rates of arrivals: the null model, in which arrivals do not depend on departures.

With a constant rate, a rhythm common to all zones (day and night) would look like links; with a
local rate it does not.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Singles, rows_by_group

RATE_HALF_WINDOW_SECONDS = 600.0
"""Arrivals this long before and after an arrival make up its local rate."""
RATE_PRIOR_EVENTS = 2.0
"""Weight, in events, of a zone's mean rate in its local rate."""
CHANCE_BIN_SECONDS = 300.0
"""Width of the time bins in which `NullRates` counts departures and arrivals."""
TABLE_ZONES_MAX = 2000
"""Up to this many zones, `NullRates` computes the rates of all pairs at once (32 MB)."""
PAIRS_AT_ONCE = 500
"""Pairs whose rates are computed together where there are more than `TABLE_ZONES_MAX` zones."""


def local_rates(t: Floats, zone: NDArray[np.int32], zones: int) -> Floats:
    """Return the rate (n,) of other arrivals (1/s) at each arrival's zone around its time.

    t (n,): times of arrivals in seconds, ascending.
    zone (n,): their zones, from 0 to ``zones`` - 1.
    """
    rates = np.zeros(len(t))
    if len(t) == 0:
        return rates
    first, last = t[0], t[-1]
    for here in rows_by_group(zone, zones):
        if len(here) == 0:
            continue

        # Count the other arrivals within the window.
        own = t[here]
        low, high = own - RATE_HALF_WINDOW_SECONDS, own + RATE_HALF_WINDOW_SECONDS
        others = np.searchsorted(own, high, "right") - np.searchsorted(own, low, "left") - 1

        # Divide by the part of the window that is within the data.
        span = np.minimum(high, last) - np.maximum(low, first)
        mean = len(own) / max(last - first, 1.0)
        rates[here] = (others + RATE_PRIOR_EVENTS) / (span + RATE_PRIOR_EVENTS / mean)
    return rates


class NullRates:
    """Null model of zone pairs: arrivals per second at one zone around departures from another.

    Departures and arrivals are counted in time bins, and the rate of arrivals is averaged over the
    bins of the departures and their neighbours. So a rhythm common to all zones is part of it.

    left_t, left_zone (n,): times of departures (seconds, ascending, at least one), and their zones.
    came_t, came_zone (m,): the same of arrivals.
    zones: number of zones.
    """

    def __init__(
        self,
        left_t: Floats,
        left_zone: NDArray[np.int32],
        came_t: Floats,
        came_zone: NDArray[np.int32],
        zones: int,
    ) -> None:
        # Count departures and arrivals (zones, bins).
        first = min(left_t[0], came_t[0])
        n = int((max(left_t[-1], came_t[-1]) - first) // CHANCE_BIN_SECONDS) + 1
        self._left = _per_bin(left_t, left_zone, first, n, zones)
        came = _per_bin(came_t, came_zone, first, n, zones)

        # Arrivals in each bin and its two neighbours, and the seconds these have.
        self._around = np.copy(came)
        self._around[:, 1:] += came[:, :-1]
        self._around[:, :-1] += came[:, 1:]
        bins = np.full(n, 3.0)
        bins[0] -= 1.0
        bins[-1] -= 1.0
        self._seconds = CHANCE_BIN_SECONDS * np.maximum(bins, 1.0)

        # Mean rate of arrivals over the departures, for all pairs of zones.
        self._number = np.maximum(self._left.sum(axis=1, dtype=float), 1.0)
        self._table = None
        if zones <= TABLE_ZONES_MAX:
            rate = self._around / self._seconds
            self._table = (self._left.astype(float) @ rate.T) / self._number[:, None]

    def rates_of(
        self, source: NDArray[np.signedinteger[Any]], target: NDArray[np.signedinteger[Any]]
    ) -> Floats:
        """Return the rate of arrivals (P,), 1/s, at ``target`` around departures of ``source``.

        source, target (P,): zones.
        """
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
    """Return the number of events (zones, n) of each zone in ``n`` time bins from ``first`` on."""
    when = ((t - first) // CHANCE_BIN_SECONDS).astype(np.int64)
    events = np.zeros(zones * n, np.float32)
    np.add.at(events, zone.astype(np.int64) * n + when, 1.0)
    return events.reshape(zones, n)
