"""Rates of arrivals under the null model, in which arrivals have nothing to do with departures.

The rates are local in time. With a constant rate, a rhythm common to all zones (day and night)
would look like links between them. `local_rates` gives the rate around each arrival, which the
joint fit uses; `NullRates` the mean rate at one zone around the departures from another, from which
the expected number of candidates of two unrelated zones follows.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

from camtopod.arrays import Floats, Singles, row_slices, rows_by_group

RATE_HALF_WINDOW_SECONDS = 600.0
"""Half the width, in seconds, of the window around an arrival in which its local rate is counted.
"""
RATE_PRIOR_EVENTS = 2.0
"""Weight, in events, of a zone's mean rate in its local rates."""
CHANCE_BIN_SECONDS = 300.0
"""Width of the time bins in which `NullRates` counts departures and arrivals."""


def local_rates(t: Floats, zone: NDArray[np.int32], zones: int) -> Floats:
    """Return the rate (n, 1/s) of other arrivals at the zone of each arrival, around its time.

    t (n,): times of arrivals in seconds, ascending.
    zone (n,): their zones, from 0 to ``zones`` - 1.
    """
    rates = np.zeros(len(t))
    if len(t) == 0:
        return rates
    first = t[0]
    last = t[-1]
    for rows in rows_by_group(zone, zones):
        if len(rows) == 0:
            continue

        # Count the other arrivals within the window around each arrival.
        times = t[rows]
        low = times - RATE_HALF_WINDOW_SECONDS
        high = times + RATE_HALF_WINDOW_SECONDS
        neighbours = np.searchsorted(times, high, "right") - np.searchsorted(times, low, "left") - 1

        # Divide by the part of the window that is within the data.
        span = np.minimum(high, last) - np.maximum(low, first)
        mean = len(times) / max(last - first, 1.0)
        rates[rows] = (neighbours + RATE_PRIOR_EVENTS) / (span + RATE_PRIOR_EVENTS / mean)
    return rates


class NullRates:
    """Null model of pairs of zones: rate of arrivals at one zone around departures from another.

    Departures and arrivals are counted in time bins. For each departure, the rate of arrivals is
    that in its bin and the two bins beside it, and the mean is taken over the departures. So a
    rhythm common to all zones is part of the null model.

    departure_t, departure_zone (n,): times (seconds) and zones of departures, not empty.
    arrival_t, arrival_zone (m,): times (seconds) and zones of arrivals, not empty.
    zones: number of zones.
    """

    def __init__(
        self,
        departure_t: Floats,
        departure_zone: NDArray[np.int32],
        arrival_t: Floats,
        arrival_zone: NDArray[np.int32],
        zones: int,
    ) -> None:
        # Count departures and arrivals (zones, bins).
        first = min(departure_t.min(), arrival_t.min())
        n = int((max(departure_t.max(), arrival_t.max()) - first) // CHANCE_BIN_SECONDS) + 1
        self._departures = _per_bin(departure_t, departure_zone, first, n, zones)
        arrivals = _per_bin(arrival_t, arrival_zone, first, n, zones)

        # Arrivals in each bin and its two neighbours, and the seconds that these bins last.
        beside = np.ones(3)
        self._around = convolve1d(arrivals, beside, mode="constant")
        self._seconds = CHANCE_BIN_SECONDS * convolve1d(np.ones(n), beside, mode="constant")

        self._number = np.maximum(self._departures.sum(axis=1, dtype=float), 1.0)

    def rates_of(
        self, source: NDArray[np.signedinteger[Any]], target: NDArray[np.signedinteger[Any]]
    ) -> Floats:
        """Return the mean rate of arrivals at one zone around departures from another, (P, 1/s).

        source, target (P,): zones of departure and of arrival of P pairs.
        """
        rates: Floats = np.zeros(len(source))
        for part in row_slices(len(source)):
            departures = self._departures[source[part]].astype(float)
            rate = self._around[target[part]] / self._seconds
            rates[part] = np.einsum("pn,pn->p", departures, rate)
        rates /= self._number[source]
        return rates

    def rates_to(self, target: NDArray[np.signedinteger[Any]]) -> Singles:
        """Return these rates from all zones to some, (zones, k).

        target (k,): the zones of arrival.
        """
        rate = (self._around[target] / self._seconds).astype(np.float32)
        rates: Singles = self._departures @ rate.T / self._number[:, None].astype(np.float32)
        return rates


def _per_bin(t: Floats, zone: NDArray[np.int32], first: float, n: int, zones: int) -> Singles:
    """Return the number of events (zones, n) of each zone in ``n`` time bins from ``first`` on."""
    bin_number = ((t - first) // CHANCE_BIN_SECONDS).astype(np.int64)
    events = np.zeros(zones * n, np.float32)
    np.add.at(events, zone.astype(np.int64) * n + bin_number, 1.0)
    return events.reshape(zones, n)
