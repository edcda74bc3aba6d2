"""Events in the form that baselines for links take: true zones, no clutter, ordered by time."""

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
    """Range of the lags at which an arrival is looked for, seconds after the departure."""

    low: float
    high: float


NARROW, WIDE = Lags(-20.0, 120.0), Lags(-120.0, 180.0)
"""Ranges of lags, seconds; baselines are given both, and the better result counts.

`NARROW` holds most transit times of the simulated networks, and so has fewer spurious candidates;
`WIDE` is the range that camtopod searches by default.
"""
CANDIDATES_MAX = 10_000_000
"""Most candidates a baseline weighs; beyond, only those of the newest arrivals."""


class Crossings(NamedTuple):
    """Departures (left) and arrivals (came), each by time in seconds, with the index of their zone.

    ``zones`` are names; ``camera`` is the index of each zone's camera.
    """

    zones: list[str]
    camera: Longs
    left: Floats
    left_zone: Longs
    came: Floats
    came_zone: Longs

    @property
    def between(self) -> NDArray[np.bool_]:
        """True where two zones (zones, zones) lie in different cameras, and so may be linked."""
        result: NDArray[np.bool_] = self.camera[:, None] != self.camera[None, :]
        return result


class Candidates(NamedTuple):
    """Candidates by arrival: those within the lags whose zones lie in different cameras.

    ``departure`` and ``arrival`` are indices; ``lag`` is in seconds.
    """

    departure: Longs
    arrival: Longs
    pair: Longs
    """Pair of zones, ``from * zones + to``."""
    lag: Floats
    lags: Lags


def crossings(events: Sequence[Event], truth: Truth) -> Crossings:
    """Return the events of objects without clutter, with their true zones.

    Without positions a camera is one zone, named by its first true zone; without true zones it is
    one zone named after the camera.
    """
    # Zones as the baselines take them, and the index of each true zone.
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

    # Zone of each event; clutter is dropped.
    mine = np.array(truth.identity) != CLUTTER
    if truth.zones:
        mine &= np.array(truth.zone) >= 0
        at = np.array(index, dtype=np.int64)[np.array(truth.zone)]
    else:
        names = [TrueZone(name, name) for name in truth.cameras]
        at = np.array([cameras[event.camera] for event in events], dtype=np.int64)

    # Departures and arrivals, each by time.
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
    """Return all candidates, or those of the newest arrivals if they exceed ``candidates_max``."""
    # Departures within the lags of each arrival; counted from the newest arrival back.
    low = np.searchsorted(seen.left, seen.came - lags.high, side="left")
    high = np.searchsorted(seen.left, seen.came - lags.low, side="right")
    n = high - low
    kept = int(np.searchsorted(np.cumsum(n[::-1]), candidates_max, side="right"))
    n[: len(n) - kept] = 0

    # Expand to pairs and keep those of two cameras.
    arrival = np.repeat(np.arange(len(n)), n)
    departure = np.arange(len(arrival)) + np.repeat(low - (np.cumsum(n) - n), n)
    source, target = seen.left_zone[departure], seen.came_zone[arrival]
    keep = np.flatnonzero(seen.camera[source] != seen.camera[target])
    departure, arrival = departure[keep], arrival[keep]
    pair = source[keep] * len(seen.zones) + target[keep]
    return Candidates(departure, arrival, pair, seen.came[arrival] - seen.left[departure], lags)


def lag_counts(seen: Crossings, found: Candidates, width: float) -> tuple[Floats, Floats]:
    """Return the cross-correlation of departures and arrivals, and the centres of its bins.

    The correlation (zones, zones, bins) counts the candidates in each lag bin.
    """
    (low, high), zones = found.lags, len(seen.zones)
    bins = math.ceil((high - low) / width)
    at = np.minimum(((found.lag - low) / width).astype(np.int64), bins - 1)
    counts = np.bincount(found.pair * bins + at, minlength=zones * zones * bins)
    centres = low + width * (np.arange(bins, dtype=np.float64) + 0.5)
    return counts.reshape(zones, zones, bins).astype(np.float64), centres
