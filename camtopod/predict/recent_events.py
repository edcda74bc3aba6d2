"""The newest exits or arrivals as columns, so that those that matter are found at once."""

from __future__ import annotations

import math
from bisect import insort

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from camtopod.arrays import Floats
from camtopod.records import Zone

RECENT_MAX = 2000
"""So many count."""


class Arrival(Struct):
    """An entry into a view."""

    t: float
    zone: int
    rate: float
    """Rate (1/s) at which all that is known so far could have caused it."""


class Recent:
    """The newest exits or arrivals in the order they came, as columns."""

    def __init__(self) -> None:
        self.t = np.zeros(2 * RECENT_MAX)
        self.zone = np.zeros(2 * RECENT_MAX, np.int32)
        self.rate = np.zeros(2 * RECENT_MAX)
        """Of an arrival, see `Arrival`."""
        self.stop = 0
        """Behind the newest."""

    def save(self) -> tuple[Floats, NDArray[np.int32]]:
        """Copies of times and zones (n,), oldest first; rates are not kept."""
        return self.t[: self.stop].copy(), self.zone[: self.stop].copy()

    def load(self, t: Floats, zone: NDArray[np.int32]) -> None:
        """Go on from what `save` gave, instead of what was there."""
        self.stop = len(t)
        self.t[: self.stop], self.zone[: self.stop] = t, zone

    def append(self, t: float, zone: int, rate: float = 0.0) -> None:
        """The next one; ``t`` in seconds, ``rate`` as of `Arrival`. Makes room by dropping what
        does not count.
        """
        if self.stop == len(self.t):
            self.stop = RECENT_MAX
            for column in (self.t, self.zone, self.rate):
                column[:RECENT_MAX] = column[RECENT_MAX:]
        self.t[self.stop], self.zone[self.stop], self.rate[self.stop] = t, zone, rate
        self.stop += 1

    @property
    def first(self) -> int:
        """The oldest that counts."""
        return max(self.stop - RECENT_MAX, 0)

    def after(self, t: float) -> tuple[Floats, NDArray[np.int32]]:
        """Times and zones (n,) of those later than ``t``, as far as events come by time."""
        first = max(int(self.t[: self.stop].searchsorted(t)), self.first)
        return self.t[first : self.stop], self.zone[first : self.stop]

    def arrivals(self) -> list[Arrival]:
        """Those that count, oldest first."""
        columns = (
            column[self.first : self.stop].tolist() for column in (self.t, self.zone, self.rate)
        )
        return [Arrival(*one) for one in zip(*columns, strict=True)]


class RecentArrivals(Recent):
    """The newest arrivals, also by zone."""

    def __init__(self) -> None:
        super().__init__()
        self.dropped = 0
        """So many are not in the columns any more."""
        self.of_zone: dict[int, list[tuple[float, int]]] = {}
        """Of each at a zone, by time, when it came and its number: its place in the columns and
        behind those that were dropped. Those before `first` do not count.
        """

    def append(self, t: float, zone: int, rate: float = 0.0) -> None:
        """The next one, as of `Recent`."""
        full = self.stop == len(self.t)
        super().append(t, zone, rate)
        if full:
            self._drop(RECENT_MAX)
        came, one = self.of_zone.setdefault(zone, []), (t, self.dropped + self.stop - 1)
        if came and one < came[-1]:
            insort(came, one)
        else:
            came.append(one)

    def _drop(self, number: int) -> None:
        self.dropped += number
        left = (
            (zone, [one for one in came if one[1] >= self.dropped])
            for zone, came in self.of_zone.items()
        )
        self.of_zone = {zone: came for zone, came in left if came}


def renumbered(before: list[Zone], now: list[Zone]) -> dict[int, int]:
    """Their zones' numbers by those of before; zones that are gone are left out."""
    index = {zone.id: k for k, zone in enumerate(now)}
    return {k: index[zone.id] for k, zone in enumerate(before) if zone.id in index}


def take_over_arrivals(
    arrivals: RecentArrivals, before: RecentArrivals, moved: dict[int, int]
) -> None:
    """Those that count at zones that are left, into ``arrivals``, which has none yet."""
    those = slice(before.first, before.stop)
    zone = _moved(before.zone[those], moved)
    kept = zone >= 0
    t, zone, rate = before.t[those][kept], zone[kept], before.rate[those][kept]
    arrivals.load(t, zone)
    arrivals.rate[: arrivals.stop] = rate
    order = np.lexsort((t, zone))
    came = list(zip(t[order].tolist(), order.tolist(), strict=True))
    starts = np.flatnonzero(np.diff(zone[order], prepend=-1)).tolist()
    for number, first, end in zip(
        zone[order[starts]].tolist(), starts, [*starts[1:], len(came)], strict=False
    ):
        arrivals.of_zone[number] = came[first:end]


def take_over_exits(exits: Recent, before: Recent, moved: dict[int, int]) -> None:
    """The same of the exits."""
    t, zone = before.after(-math.inf)
    zone = _moved(zone, moved)
    exits.load(t[zone >= 0], zone[zone >= 0])


def _moved(zone: NDArray[np.int32], moved: dict[int, int]) -> NDArray[np.int32]:
    """-1 for those that are gone."""
    now = np.full(int(zone.max(initial=0)) + 1, -1, np.int32)
    for k, number in moved.items():
        if k < len(now):
            now[k] = number
    return now[zone]
