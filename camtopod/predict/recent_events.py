"""Storage of the newest exits or arrivals as columns, so that they can be searched quickly.

A `Predictor` has one `RecentEvents` for exits, which are possible causes of later arrivals, and one
for arrivals, which may be of the object of an exit. Zones are indices in the topology version;
`moved_zones` translates them from an older version.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from msgspec.structs import astuple

from camtopod.arrays import Floats, Ints
from camtopod.records import Zone

RECENT_MAX = 2000
"""Number of the newest exits, and of the newest arrivals, that are remembered."""


class RecentState(Struct):
    """The columns of `RecentEvents`, which are its saved state."""

    t: Floats
    """(n,) corrected times in seconds, oldest first."""
    zone: Ints
    """(n,) indices of the zones."""
    label: Ints
    """(n,) numbers of the labels, as `Labels` has them."""
    entry_t: Floats
    """(n,) corrected times, in seconds, of the entries whose passages ended with the exits; minus
    infinity for arrivals, and if unknown when the exit was heard.
    """
    entry: Ints
    """(n,) indices of the zones of these entries; -1 if unknown."""


class RecentEvents:
    """The `RECENT_MAX` newest exits, or arrivals, by time; of equal times as they were observed.

    The columns are views of arrays with some room at the end; see `append`.
    """

    def __init__(self) -> None:
        size = 2 * RECENT_MAX
        t, entry_t = np.zeros((2, size))
        zone, label, entry = np.zeros((3, size), np.int32)
        self._columns = RecentState(t, zone, label, entry_t, entry)
        self._stop = 0

    @property
    def t(self) -> Floats:
        """Corrected times (n,) in seconds, oldest first."""
        return self._columns.t[self._first : self._stop]

    @property
    def zone(self) -> Ints:
        """Indices of the zones (n,)."""
        return self._columns.zone[self._first : self._stop]

    @property
    def label(self) -> Ints:
        """Numbers of the labels (n,), as `Labels` has them."""
        return self._columns.label[self._first : self._stop]

    def append(
        self,
        t: float,
        zone: int,
        label: int,
        entry_t: float = -math.inf,
        entry: int = -1,
    ) -> None:
        """Add an event at corrected time ``t``.

        entry_t (seconds), entry: corrected time, and zone, of the entry whose passage ended, if it
            is an exit.
        """
        if self._stop == len(self._columns.t):
            self.load(self.save())
        place = self._stop
        if place and t < self._columns.t[place - 1]:
            place = self._first + int(self.t.searchsorted(t, "right"))
        row = (t, zone, label, entry_t, entry)
        for column, value in zip(astuple(self._columns), row, strict=True):
            column[place + 1 : self._stop + 1] = column[place : self._stop]
            column[place] = value
        self._stop += 1

    def save(self) -> RecentState:
        """Return a copy of the columns."""
        rows = slice(self._first, self._stop)
        return RecentState(*(column[rows].copy() for column in astuple(self._columns)))

    def load(self, state: RecentState) -> None:
        """Replace all events by the given ones, oldest first."""
        self._stop = len(state.t)
        for column, values in zip(astuple(self._columns), astuple(state), strict=True):
            column[: self._stop] = values

    def after(self, t: float) -> RecentState:
        """Return the columns of the events from ``t`` on, as views."""
        rows = slice(self._first + int(self.t.searchsorted(t)), self._stop)
        return RecentState(*[column[rows] for column in astuple(self._columns)])

    def take_over(
        self, older: RecentEvents, new_zones: dict[int, int], labels: dict[int, int]
    ) -> None:
        """Replace all events by those of an older version, except at zones that are gone.

        new_zones: new index of each zone by its old index (`moved_zones`).
        labels: new number of each label by its old number.
        """
        # New number of each old zone; -1 if it is gone, or unknown.
        columns = older.save()
        zones = int(max(columns.zone.max(initial=0), columns.entry.max(initial=0))) + 1
        number = np.array([*(new_zones.get(zone, -1) for zone in range(zones)), -1], np.int32)
        columns.zone, columns.entry = number[columns.zone], number[columns.entry]
        columns.label = np.array([*labels.values(), -1], np.int32)[columns.label]
        mask = columns.zone >= 0
        self.load(RecentState(*(column[mask] for column in astuple(columns))))

    @property
    def _first(self) -> int:
        """Index of the oldest remembered event in the arrays."""
        return max(self._stop - RECENT_MAX, 0)


def moved_zones(before: list[Zone], now: list[Zone]) -> dict[int, int]:
    """Return the index in the present version of each zone of an older version, by its old index.

    before, now: zones of the older and of the present version. Zones that are gone are left out.
    """
    index = {zone.id: k for k, zone in enumerate(now)}
    return {k: index[zone.id] for k, zone in enumerate(before) if zone.id in index}
