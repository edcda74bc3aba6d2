"""Limits on the memory and time of one fit: counts, so that all machines make the same version.

Nearly all memory and time of a fit go into *event pairs* (a departure and an arrival within the
range of lags) and into tables with a row for each pair of zones. The number of event pairs grows
with the square of the traffic, so each stage of a fit first counts them and then uses at most a
fixed number. Beyond the limit it leaves out the arrivals with the most departures in reach
(`arrivals_within`): they carry the least information.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Bools, Rows

LONGEST_SECONDS = (120.0, 2160.0)
"""Longest lag between two views that is looked for, before the exit and after it. Who is gone for
more than half an hour has rarely been on one way all the time; and the longer the lag, the wider
its bin and the more chance is in it, so that only a very busy way could be told.
"""
EVENT_PAIRS_MAX = 4_000_000
"""Event pairs in one step of a fit: in which the range of lags or overlapping views are looked for,
and from which the evidence for links is estimated or paths are learned (`learn.paths`).
"""
RANGE_ARRIVALS_MAX = 4_000
"""Arrivals, the newest, in which the range of lags is looked for."""
WEIGHED_MAX = 128_000_000
"""Event pairs that screening weighs in one fit, over all followed pairs of zones."""
WEIGHED_AT_ONCE = 1_000_000
ZONE_WEIGHED_AT_ONCE = 8_000_000
"""Event pairs that screening lists together, at 100 bytes each: those of several zones of arrival,
and at most those of one.
"""
PATH_CAMERAS_MAX = 128
"""Cameras of a site for which paths are learned: the search grows with the pairs of cameras."""
ZONES_PER_CAMERA_MAX = 32
"""Zones of one camera; of more, those with the most events count."""
ENTRY_PAIRS_MAX = (20_000, 600)
"""Entry kernels (`next_camera.entry_kernels`; see `of_site`). An entry kernel belongs to a pair of
a zone of entry and a zone of the next appearance.
"""
CONTEXT_CELLS_MAX = (8_000_000, 40_000)
"""Cells of a table of transitions by context (`next_camera.contexts`; see `of_site`). The table has
a row for each context of a departure and a column for each next zone.
"""


def of_site(limit: tuple[int, int], cameras: int) -> int:
    """Return a limit of a site: the first number in all, or the second a camera if that is more."""
    return max(limit[0], limit[1] * cameras)


def arrivals_within(reach: Rows, pairs_max: int) -> Bools:
    """Return a mask (n,) of arrivals to keep, so that they have at most ``pairs_max`` event pairs.

    reach (n,): number of departures in reach of each arrival, its event pairs.

    The arrivals with the fewest departures in reach are kept; of those with equally many, the
    newest.
    """
    mask = np.ones(len(reach), np.bool_)
    if int(reach.sum()) > pairs_max:
        order = np.lexsort((-np.arange(len(reach)), reach))
        mask[order[np.searchsorted(np.cumsum(reach[order]), pairs_max, side="right") :]] = False
    return mask


def fair_share(demand: Rows, total_max: int) -> int:
    """Return the limit for each of n users of a budget that keeps their sum within ``total_max``.

    demand (n,): amount that each user wants. A user that wants less than the limit leaves the rest
        of its share to the others.
    """
    order = np.sort(demand)
    larger_users = np.arange(len(order))[::-1]  # number of users that want more
    too_much = np.flatnonzero(np.cumsum(order) + order * larger_users > total_max)
    if len(too_much) == 0:
        return total_max
    k = int(too_much[0])
    return (total_max - int(order[:k].sum())) // (len(order) - k)
