"""Events as the baselines for links get them: true zones, no clutter, exits and entries by time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Longs
from camtopod.records import Event
from camtopod.sim.truth import CLUTTER, TrueZone, Truth


class Lags(NamedTuple):
    """From when to when after a departure its arrival is looked for, seconds."""

    low: float
    high: float


NARROW, WIDE = Lags(-20.0, 120.0), Lags(-120.0, 180.0)
"""Where most transits of the made-up networks lie, which spares the baselines much chance, and what
ours looks at by default. The better one counts."""
CANDIDATES_MAX = 10_000_000
"""At most this many pairs of a departure and an arrival are weighed; beyond, only the newest events
are.
"""


class Crossings(NamedTuple):
    """Departures and arrivals by time (seconds), with the index of their zone; ``zones`` names,
    ``camera`` indices.
    """

    zones: list[str]
    camera: Longs
    left: Floats
    left_zone: Longs
    came: Floats
    came_zone: Longs

    @property
    def between(self) -> NDArray[np.bool_]:
        """(zones, zones) whether a pair of zones lies in two cameras, the only ones that can be
        linked.
        """
        result: NDArray[np.bool_] = self.camera[:, None] != self.camera[None, :]
        return result


class Candidates(NamedTuple):
    """Pairs (departure, arrival) within the lags, zones in two cameras, by arrival: indices, pair
    of zones, seconds.
    """

    departure: Longs
    arrival: Longs
    pair: Longs
    """``from * zones + to``."""
    lag: Floats
    lags: Lags


def crossings(events: Sequence[Event], truth: Truth) -> Crossings:
    """The recorded events of walkers; without positions a camera is one zone, named by its first
    true one, and without true zones one named after it."""
    cameras = {name: index for index, name in enumerate(truth.cameras)}
    placed = all(zone.x is not None for zone in truth.zones)
    names: list[TrueZone] = []
    number: dict[str, int] = {}
    index: list[int] = []
    for zone in truth.zones:
        key = zone.id if placed else zone.camera
        if key not in number:
            number[key] = len(names)
            names.append(zone)
        index.append(number[key])
    mine = np.array(truth.identity) != CLUTTER
    if truth.zones:
        mine &= np.array(truth.zone) >= 0
        at = np.array(index, dtype=np.int64)[np.array(truth.zone)]
    else:
        names = [TrueZone(name, name) for name in truth.cameras]
        at = np.array([cameras[event.camera] for event in events], dtype=np.int64)
    t, at = np.array([event.t for event in events])[mine], at[mine]
    entry = np.array([event.kind for event in events])[mine] == "entry"
    order = np.argsort(t, kind="stable")
    came, left = order[entry[order]], order[~entry[order]]
    return Crossings(
        [zone.id for zone in names],
        np.array([cameras[zone.camera] for zone in names]),
        t[left],
        at[left],
        t[came],
        at[came],
    )


def candidates(
    seen: Crossings, candidates_max: int = CANDIDATES_MAX, lags: Lags = NARROW
) -> Candidates:
    """All candidates, or those of the newest arrivals when there are more than
    ``candidates_max``.
    """
    low = np.searchsorted(seen.left, seen.came - lags.high, side="left")
    high = np.searchsorted(seen.left, seen.came - lags.low, side="right")
    n = high - low
    kept = int(np.searchsorted(np.cumsum(n[::-1]), candidates_max, side="right"))
    n[: len(n) - kept] = 0
    arrival = np.repeat(np.arange(len(n)), n)
    departure = np.arange(len(arrival)) + np.repeat(low - (np.cumsum(n) - n), n)
    source, target = seen.left_zone[departure], seen.came_zone[arrival]
    keep = np.flatnonzero(seen.camera[source] != seen.camera[target])
    departure, arrival = departure[keep], arrival[keep]
    pair = source[keep] * len(seen.zones) + target[keep]
    return Candidates(departure, arrival, pair, seen.came[arrival] - seen.left[departure], lags)


def lag_counts(seen: Crossings, found: Candidates, width: float) -> tuple[Floats, Floats]:
    """Cross-correlation of departures and arrivals: (zones, zones, bins) pairs per lag bin, and the
    bins' centres.
    """
    (low, high), zones = found.lags, len(seen.zones)
    bins = math.ceil((high - low) / width)
    at = np.minimum(((found.lag - low) / width).astype(np.int64), bins - 1)
    counts = np.bincount(found.pair * bins + at, minlength=zones * zones * bins)
    centres = low + width * (np.arange(bins, dtype=np.float64) + 0.5)
    return counts.reshape(zones, zones, bins).astype(np.float64), centres
