"""Local rates: how often arrivals come at a zone around a moment, whatever the reason.

A null with a constant rate takes a common rhythm (day and night) for links; a local one does not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

RATE_HALF_WINDOW_SECONDS = 600.0
RATE_PRIOR_EVENTS = 2.0
"""The mean rate of the zone counts as much as this many events."""
CHANCE_BIN_SECONDS = 300.0


def local_rates(t: Floats, zone: NDArray[np.int32], zones: int) -> Floats:
    """Rate (1/s) at each arrival's own zone within ten minutes of it, itself left out; ``t`` (n,) ascending, in s."""
    rates = np.zeros(len(t))
    if len(t) == 0:
        return rates
    first, last = t[0], t[-1]
    order = np.argsort(zone, kind="stable")
    for here in np.split(order, np.cumsum(np.bincount(zone, minlength=zones))[:-1]):
        if len(here) == 0:
            continue
        own = t[here]
        low, high = own - RATE_HALF_WINDOW_SECONDS, own + RATE_HALF_WINDOW_SECONDS
        others = np.searchsorted(own, high, "right") - np.searchsorted(own, low, "left") - 1
        span = np.minimum(high, last) - np.maximum(low, first)
        mean = len(own) / max(last - first, 1.0)
        rates[here] = (others + RATE_PRIOR_EVENTS) / (span + RATE_PRIOR_EVENTS / mean)
    return rates


def chance_rates(
    left_t: Floats, left_zone: NDArray[np.int32], came_t: Floats, came_zone: NDArray[np.int32], zones: int
) -> Floats:
    """Arrivals per second at each zone around a departure from each zone if they have nothing to do with each other.

    (zones, zones). Both are counted in bins of some minutes, so a rhythm common to all zones is part of chance.
    """
    first = min(left_t[0], came_t[0])
    n = int((max(left_t[-1], came_t[-1]) - first) // CHANCE_BIN_SECONDS) + 1
    left = _per_bin(left_t, left_zone, first, n, zones)
    came = _per_bin(came_t, came_zone, first, n, zones)
    around = np.copy(came)
    around[:, 1:] += came[:, :-1]
    around[:, :-1] += came[:, 1:]
    bins = np.full(n, 3.0)
    bins[0] -= 1.0
    bins[-1] -= 1.0
    rate = around / (CHANCE_BIN_SECONDS * np.maximum(bins, 1.0))
    chance: Floats = (left @ rate.T) / np.maximum(left.sum(axis=1), 1.0)[:, None]
    return chance


def _per_bin(t: Floats, zone: NDArray[np.int32], first: float, n: int, zones: int) -> Floats:
    """Events in each of ``n`` bins of time from ``first`` on, (zones, n)."""
    when = ((t - first) // CHANCE_BIN_SECONDS).astype(np.int64)
    return np.bincount(zone.astype(np.int64) * n + when, minlength=zones * n).reshape(zones, n).astype(float)
