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
"""Most candidates a baseline weighs; beyond, only those of the newest entries."""


class Crossings(NamedTuple):
    """Exits and entries, each by time in seconds, with the index of their zone.

    ``zones`` are names; ``camera`` is the index of each zone's camera.
    """

    zones: list[str]
    camera: Longs
    exits: Floats
    exit_zone: Longs
    entries: Floats
    entry_zone: Longs

    @property
    def between(self) -> NDArray[np.bool_]:
        """True where two zones (zones, zones) lie in different cameras, and so may be linked."""
        result: NDArray[np.bool_] = self.camera[:, None] != self.camera[None, :]
        return result


class Candidates(NamedTuple):
    """Candidates by arrival: those within the lags whose zones lie in different cameras.

    ``departure`` is the index of an exit, ``arrival`` that of an entry; ``lag`` is in seconds.
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
    has_positions = all(zone.x is not None for zone in truth.zones)
    names: list[TrueZone] = []
    number: dict[str, int] = {}
    index: list[int] = []
    for zone in truth.zones:
        key = zone.id if has_positions else zone.camera
        if key not in number:
            number[key] = len(names)
            names.append(zone)
        index.append(number[key])

    # Zone of each event; clutter is dropped.
    is_object = np.array(truth.identity) != CLUTTER
    if truth.zones:
        is_object &= np.array(truth.zone) >= 0
        at = np.array(index, dtype=np.int64)[np.array(truth.zone)]
    else:
        names = [TrueZone(name, name) for name in truth.cameras]
        at = np.array([cameras[event.camera] for event in events], dtype=np.int64)

    # Exits and entries, each by time.
    t, at = np.array([event.t for event in events])[is_object], at[is_object]
    entry = np.array([event.kind for event in events])[is_object] == "entry"
    order = np.argsort(t, kind="stable")
    entries, exits = order[entry[order]], order[~entry[order]]
    return Crossings(
        [zone.id for zone in names],
        np.array([cameras[zone.camera] for zone in names]),
        t[exits],
        at[exits],
        t[entries],
        at[entries],
    )


def candidates(
    traffic: Crossings, candidates_max: int = CANDIDATES_MAX, lags: Lags = NARROW
) -> Candidates:
    """Return all candidates, or those of the newest entries if they exceed ``candidates_max``."""
    # Exits within the lags of each arrival; counted from the newest arrival back.
    low = np.searchsorted(traffic.exits, traffic.entries - lags.high, side="left")
    high = np.searchsorted(traffic.exits, traffic.entries - lags.low, side="right")
    n = high - low
    count = int(np.searchsorted(np.cumsum(n[::-1]), candidates_max, side="right"))
    n[: len(n) - count] = 0

    # Expand to pairs and keep those of two cameras.
    arrival = np.repeat(np.arange(len(n)), n)
    departure = np.arange(len(arrival)) + np.repeat(low - (np.cumsum(n) - n), n)
    source, target = traffic.exit_zone[departure], traffic.entry_zone[arrival]
    keep = np.flatnonzero(traffic.camera[source] != traffic.camera[target])
    departure, arrival = departure[keep], arrival[keep]
    pair = source[keep] * len(traffic.zones) + target[keep]
    return Candidates(
        departure, arrival, pair, traffic.entries[arrival] - traffic.exits[departure], lags
    )


def lag_counts(traffic: Crossings, candidates: Candidates, width: float) -> tuple[Floats, Floats]:
    """Return the cross-correlation of exits and entries, and the centres of its bins.

    The correlation (zones, zones, bins) counts the candidates in each lag bin.
    """
    (low, high), zones = candidates.lags, len(traffic.zones)
    bins = math.ceil((high - low) / width)
    at = np.minimum(((candidates.lag - low) / width).astype(np.int64), bins - 1)
    counts = np.bincount(candidates.pair * bins + at, minlength=zones * zones * bins)
    centres = low + width * (np.arange(bins, dtype=np.float64) + 0.5)
    return counts.reshape(zones, zones, bins).astype(np.float64), centres


def smoother(bins: int, sd: float) -> Floats:
    """Return a matrix (bins, bins) that spreads each bin's mass over its neighbours; rows sum to 1.

    sd: standard deviation of the Gaussian kernel, in bins.
    """
    offset = np.arange(bins)[:, None] - np.arange(bins)[None, :]
    kernel: Floats = np.exp(-0.5 * (offset / sd) ** 2)
    kernel /= kernel.sum(axis=1, keepdims=True)
    return kernel
