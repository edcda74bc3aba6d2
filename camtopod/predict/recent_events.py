"""The newest exits or arrivals in columns, so that those that matter are found quickly."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from camtopod.arrays import Floats, Ints
from camtopod.records import Zone

RECENT_MAX = 2000
"""Number of the newest exits, and of the newest arrivals, that are remembered."""


class Arrival(Struct):
    """An entry into a view."""

    t: float
    """Corrected time, seconds."""
    zone: int
    rate: float
    """Rate (1/s) of all causes of the arrival that are known so far."""


class RecentEvents:
    """The newest exits or arrivals, in the order in which they came."""

    def __init__(self) -> None:
        self._t = np.zeros(2 * RECENT_MAX)
        self._zone = np.zeros(2 * RECENT_MAX, np.int32)
        self._rate = np.zeros(2 * RECENT_MAX)
        self._stop = 0

    @property
    def t(self) -> Floats:
        """Corrected times (n,) in seconds, oldest first."""
        return self._t[self._first : self._stop]

    @property
    def zone(self) -> Ints:
        """Zones (n,)."""
        return self._zone[self._first : self._stop]

    @property
    def rate(self) -> Floats:
        """Rates (n,) of arrivals, see `Arrival`; 0 for exits."""
        return self._rate[self._first : self._stop]

    @property
    def is_full(self) -> bool:
        """Return True if older ones may have been forgotten."""
        return self._stop >= RECENT_MAX

    def append(self, t: float, zone: int, rate: float = 0.0) -> None:
        """Add the newest one: corrected time, zone, and rate if it is an arrival."""
        if self._stop == len(self._t):
            self.load(self.t, self.zone, self.rate)
        self._t[self._stop], self._zone[self._stop], self._rate[self._stop] = t, zone, rate
        self._stop += 1

    def load(self, t: Floats, zone: Ints, rate: Floats | float = 0.0) -> None:
        """Replace all by these (n,), oldest first."""
        self._stop = len(t)
        self._t[: self._stop], self._zone[: self._stop] = t, zone
        self._rate[: self._stop] = rate

    def after(self, t: float) -> tuple[Floats, Ints]:
        """Return times and zones (n,) of those later than ``t``, if all came in order of time."""
        first = max(int(self._t[: self._stop].searchsorted(t)), self._first)
        return self._t[first : self._stop], self._zone[first : self._stop]

    def arrivals(self) -> list[Arrival]:
        """Return all as arrivals, oldest first."""
        columns = (column.tolist() for column in (self.t, self.zone, self.rate))
        return [Arrival(*one) for one in zip(*columns, strict=True)]

    def take_over(self, older: RecentEvents, moved: dict[int, int]) -> None:
        """Replace all by those of an older version, except those at zones that are gone.

        moved: see `moved_zones`.
        """
        # New number of each old zone; -1 if it is gone.
        number = np.full(int(older.zone.max(initial=0)) + 1, -1, np.int32)
        for before, now in moved.items():
            if before < len(number):
                number[before] = now

        zone = number[older.zone]
        kept = zone >= 0
        self.load(older.t[kept], zone[kept], older.rate[kept])

    @property
    def _first(self) -> int:
        """Place of the oldest that is remembered; those before it make room for newer ones."""
        return max(self._stop - RECENT_MAX, 0)


def moved_zones(before: list[Zone], now: list[Zone]) -> dict[int, int]:
    """Return the number of each zone of an older version in the present one, by its number there.

    Zones that are gone are left out.
    """
    index = {zone.id: k for k, zone in enumerate(now)}
    return {k: index[zone.id] for k, zone in enumerate(before) if zone.id in index}
