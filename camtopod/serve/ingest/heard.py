"""Which events of a camera were heard, or delivered, already: each is observed once.

An event comes twice, in any order: by a publication, which the bus may drop, and by its delivery
from a spool. Numbers of one boot that follow each other are kept as one range, so there is little
to keep unless much is dropped.
"""

from __future__ import annotations

from bisect import bisect_right

HEARD_BOOTS_MAX = 16
"""Boots of a camera whose numbers are remembered, those that came last."""
HEARD_RANGES_MAX = 64
"""Ranges of numbers of a boot that are remembered, the highest."""


class Heard:
    """The numbers of one camera's events, by boot."""

    def __init__(self) -> None:
        self._boots: dict[str, list[list[int]]] = {}
        """By boot, that of the last event last: ranges [first, last], rising, with gaps between."""

    def __bool__(self) -> bool:
        return bool(self._boots)

    def add(self, boot: str, seq: int) -> bool:
        """Add a number; return False if it was there."""
        ranges = self._boots[boot] = self._boots.pop(boot, [])
        place = bisect_right(ranges, seq, key=lambda one: one[0])
        if place and seq <= ranges[place - 1][1]:
            return False

        # Join it with the ranges before and after it.
        ranges.insert(place, [seq, seq])
        for after in (place + 1, place):
            if 0 < after < len(ranges) and ranges[after - 1][1] + 1 == ranges[after][0]:
                ranges[after - 1][1] = ranges.pop(after)[1]

        # Forget the oldest of too many.
        if len(ranges) > HEARD_RANGES_MAX:
            del ranges[0]
        if len(self._boots) > HEARD_BOOTS_MAX:
            del self._boots[next(iter(self._boots))]
        return True
