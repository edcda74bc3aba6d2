"""The numbers of one camera's events: each event counts once, however often it comes.

Numbers of one boot that follow each other are kept as one range, so there is little to keep unless
much is missing.
"""

from __future__ import annotations

from bisect import bisect_right

from msgspec import Struct

BOOTS_MAX = 16
"""Boots of a camera whose numbers are remembered, those that came last."""
RANGES_MAX = 64
"""Ranges of numbers of a boot that are remembered, the highest."""


class EventNumbers(Struct):
    """The numbers of one camera's events, by boot.

    boots: by boot, that of the last event last: ranges [first, last], rising, with gaps between.
    """

    boots: dict[str, list[list[int]]] = {}

    def __bool__(self) -> bool:
        return bool(self.boots)

    def add(self, boot: str, seq: int) -> bool:
        """Add a number; return False if it was there."""
        ranges = self.boots[boot] = self.boots.pop(boot, [])
        if ranges and seq == ranges[-1][1] + 1:  # the usual case
            ranges[-1][1] = seq
            return True
        place = bisect_right(ranges, seq, key=lambda numbers: numbers[0])
        if place and seq <= ranges[place - 1][1]:
            return False

        # Join it with the ranges before and after it.
        ranges.insert(place, [seq, seq])
        for after in (place + 1, place):
            if 0 < after < len(ranges) and ranges[after - 1][1] + 1 == ranges[after][0]:
                ranges[after - 1][1] = ranges.pop(after)[1]

        # Forget the oldest of too many.
        if len(ranges) > RANGES_MAX:
            del ranges[0]
        if len(self.boots) > BOOTS_MAX:
            del self.boots[next(iter(self.boots))]
        return True
