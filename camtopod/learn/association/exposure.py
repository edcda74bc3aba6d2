"""Exposure: how many departures could have been seen to arrive after each lag."""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, rows_by_group
from camtopod.learn.traffic import Departures
from camtopod.topology import LagBins


def exposures(departures: Departures, bins: LagBins, zones: int, until: float) -> Floats:
    """Return the exposed departures of each zone per lag bin, (zones, bins).

    A lag bin after the exit is exposed once the window reaches past it. A lag bin before the exit
    is exposed to the extent that the passage had begun by then, so it may count in part.

    until (seconds): end of the window.
    """
    exposed = np.zeros((zones, bins.size))
    ahead = int((bins.edges[1:] <= 0).sum())
    before = bins.edges[: ahead + 1]
    for zone, here in enumerate(rows_by_group(departures.zone, zones)):
        # Lags after the exit: departures at least this long before the end of the window.
        left = np.sort(until - departures.t[here])
        exposed[zone] = len(here) - np.searchsorted(left, bins.edges[1:], side="left")

        # Lags before the exit: mean number of objects in view within each bin, as the difference of
        # the cumulative seconds in view at its edges. This also holds where a bin is exposed in
        # part: if all passages last equally long, the few exposed seconds of their last bin would
        # otherwise look like a peak.
        stay = np.sort(np.minimum(departures.t[here] - departures.since[here], -bins.edges[0]))
        shorter = np.searchsorted(stay, -before, side="right")
        longer = np.append(np.cumsum(stay[::-1])[::-1], 0.0)[shorter]
        exposed[zone, :ahead] = (
            np.diff(longer + (len(here) - shorter) * before) / bins.widths[:ahead]
        )
    return exposed
