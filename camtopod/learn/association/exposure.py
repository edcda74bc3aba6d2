"""Exposure: how many departures could have been seen to arrive after each lag."""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, rows_of
from camtopod.learn.traffic import Departures
from camtopod.topology import LagBins


def exposures(departures: Departures, bins: LagBins, zones: int, until: float) -> Floats:
    """Departures of each zone whose lag bin could have been seen: (zones, bins).

    A bin after the exit is exposed once the window up to it is over (``until``, seconds); one
    before the exit as far as the passage had begun by then.
    """
    exposed = np.zeros((zones, bins.size))
    ahead = int((bins.edges[1:] <= 0).sum())
    before = bins.edges[: ahead + 1]
    for zone, here in enumerate(rows_of(departures.zone, zones)):
        left = np.sort(until - departures.t[here])
        exposed[zone] = len(here) - np.searchsorted(left, bins.edges[1:], side="left")
        # The seconds in view by each edge, added up, grow by how many were in view, also where a
        # bin is exposed in part: where all passages are taken to last equally long, its few seconds
        # would else look like a peak.
        stay = np.sort(np.minimum(departures.t[here] - departures.since[here], -bins.edges[0]))
        shorter = np.searchsorted(stay, -before, side="right")
        longer = np.append(np.cumsum(stay[::-1])[::-1], 0.0)[shorter]
        exposed[zone, :ahead] = (
            np.diff(longer + (len(here) - shorter) * before) / bins.widths[:ahead]
        )
    return exposed
