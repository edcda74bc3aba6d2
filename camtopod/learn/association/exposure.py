"""Exposure: how many departures could have been seen to arrive after each lag.

Hazards are rates per exposed departure. A departure shortly before the end of the window is not
exposed to long lags, as an arrival after such a lag would not be in the window yet; and it is
exposed to negative lags (an arrival in an overlapping view before the exit) only up to the duration
of its passage.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, rows_by_group
from camtopod.learn.association.problem import Problem


def exposures(problem: Problem) -> Floats:
    """Return the number of departures exposed to each bin of each range of lags, (R, bins).

    A departure is exposed to a lag bin after the exit if the window reaches past the bin. It is
    exposed to a lag bin before the exit as far as its passage had begun by then, possibly in part.
    """
    bins = problem.bins
    number, t, since = problem.delayed_departures()
    exposed = np.zeros((problem.range_count, bins.size))
    ahead = int((bins.edges[1:] <= 0).sum())
    before = bins.edges[: ahead + 1]
    for k, rows in enumerate(rows_by_group(number, len(exposed))):
        # Lags after the exit: departures that are at least the lag before the end of the window.
        remaining = np.sort(problem.until - t[rows])
        exposed[k] = len(rows) - np.searchsorted(remaining, bins.edges[1:], side="left")

        # Lags before the exit: mean number of objects in view within each bin, as the difference of
        # the cumulative seconds in view at its edges. This also holds where a bin is exposed in
        # part: if all passages last equally long, the few exposed seconds of their last bin would
        # otherwise look like a peak.
        dwell = np.sort(np.minimum(t[rows] - since[rows], -bins.edges[0]))
        shorter = np.searchsorted(dwell, -before, side="right")
        longer = np.append(np.cumsum(dwell[::-1])[::-1], 0.0)[shorter]
        exposed[k, :ahead] = np.diff(longer + (len(rows) - shorter) * before) / bins.widths[:ahead]
    return exposed
