"""The newest exits or arrivals as columns, so that those that matter are found at once."""

from __future__ import annotations

from bisect import insort

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

Floats = NDArray[np.float64]

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
        """The next one; ``t`` in seconds, ``rate`` as of `Arrival`. Makes room by dropping what does not count."""
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
        columns = (column[self.first : self.stop].tolist() for column in (self.t, self.zone, self.rate))
        return [Arrival(*one) for one in zip(*columns, strict=True)]


class RecentArrivals(Recent):
    """The newest arrivals, also by zone."""

    def __init__(self) -> None:
        super().__init__()
        self.dropped = 0
        """So many are not in the columns any more."""
        self.of_zone: dict[int, list[tuple[float, int]]] = {}
        """Of each at a zone, by time, when it came and its number: its place in the columns and behind those that were
        dropped. Those before `first` do not count.
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
        left = ((zone, [one for one in came if one[1] >= self.dropped]) for zone, came in self.of_zone.items())
        self.of_zone = {zone: came for zone, came in left if came}
