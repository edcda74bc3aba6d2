"""What the predictor over a new version takes over of what that over the one before has observed, all at once: exits
that are to be predicted wait meanwhile.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.recent import Recent, RecentArrivals
from camtopod.records import Zone


def renumbered(before: list[Zone], now: list[Zone]) -> dict[int, int]:
    """Their zones' numbers by those of before; zones that are gone are left out."""
    index = {zone.id: k for k, zone in enumerate(now)}
    return {k: index[zone.id] for k, zone in enumerate(before) if zone.id in index}


def take_over_arrivals(arrivals: RecentArrivals, before: RecentArrivals, moved: dict[int, int]) -> None:
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
    for number, first, end in zip(zone[order[starts]].tolist(), starts, [*starts[1:], len(came)], strict=False):
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
