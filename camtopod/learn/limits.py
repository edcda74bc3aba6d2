"""Limits on the work of one fit.

They are counts, not times: the same events give the same version on any machine, however fast it
is.

Theory of operation. Nearly all memory and time of a fit go into pairs of a departure and an arrival
within the range of lags, and into tables with a row for each pair of zones. The number of events in
a window is limited, but the number of pairs grows with the square of the traffic: 30,000 departures
and as many arrivals within five minutes are 900 million pairs. So each stage first counts its
pairs, which is cheap because times are sorted, and then takes at most a fixed number of them.
Beyond the limit it leaves out the arrivals with the most departures in reach (`arrivals_within`).
They carry the least information, as each of them may have come from anywhere, and they come from
the times and places where a camera floods. Arrivals at other times are unaffected, and so is every
site that stays below the limits: a hundred cameras with ordinary traffic need a tenth of each.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Counts = NDArray[np.intp]

LOOKED_PER_EVENT_MAX = 400
"""Pairs counted when the sources of one zone are screened, for each event of the window."""
WEIGHED_MAX = 64_000_000
"""Pairs, along the followed pairs of zones, that screening weighs in one fit."""
WEIGHED_AT_ONCE = 8_000_000
"""Pairs of one zone of arrival that screening weighs together, at 50 bytes each."""
JUDGED_MAX = 6_000_000
"""Pairs that the cross-validation of the found links uses in one fit."""
FOLLOWED_MAX = 5_000_000
"""Candidates that the fit for prediction follows (`next_camera.fit`)."""
ZONES_PER_CAMERA_MAX = 32
"""Zones of one camera, those with the most events."""
ZONE_PAIRS_MAX, ZONE_PAIRS_PER_CAMERA_MAX = 20_000, 250
"""Pairs of zones that are followed on a site, and for each camera; the larger limit counts."""
ENTRY_PAIRS_MAX, ENTRY_PAIRS_PER_CAMERA_MAX = 20_000, 600
"""Pairs of a zone of entry and a zone of the next appearance (`entry_kernels`) on a site, and for
each camera; the larger limit counts.
"""
CONTEXT_CELLS_MAX, CONTEXT_CELLS_PER_CAMERA_MAX = 8_000_000, 40_000
"""Cells of a table with a row for each context of a departure (`next_camera.contexts`) on a site,
and for each camera; the larger limit counts.
"""


def arrivals_within(reach: Counts, most: int) -> NDArray[np.bool_]:
    """Return which arrivals to keep so that their pairs are at most ``most``, as a mask (n,).

    The arrivals with the fewest departures in ``reach`` (n,) are kept; of those with equally many,
    the newest.
    """
    kept = np.ones(len(reach), np.bool_)
    if int(reach.sum()) > most:
        order = np.lexsort((-np.arange(len(reach)), reach))
        kept[order[np.searchsorted(np.cumsum(reach[order]), most, side="right") :]] = False
    return kept


def fair_share(wanted: Counts, most: int) -> int:
    """Return the largest share of each that keeps the sum of all within ``most``.

    Those that want less than the share, by ``wanted`` (n,), leave the rest of it to the others.
    """
    order = np.sort(wanted)
    others = np.arange(len(order))[::-1]  # number of those that want more
    too_much = np.flatnonzero(np.cumsum(order) + order * others > most)
    if len(too_much) == 0:
        return most
    k = int(too_much[0])
    return (most - int(order[:k].sum())) // (len(order) - k)


def zone_pairs_max(cameras: int) -> int:
    """Return the largest number of zone pairs that are followed on a site of ``cameras``."""
    return max(ZONE_PAIRS_MAX, ZONE_PAIRS_PER_CAMERA_MAX * cameras)


def entry_pairs_max(cameras: int) -> int:
    """Return the largest number of pairs of an entry zone and a next zone on such a site."""
    return max(ENTRY_PAIRS_MAX, ENTRY_PAIRS_PER_CAMERA_MAX * cameras)


def context_cells_max(cameras: int) -> int:
    """Return the largest number of cells of a context table on such a site."""
    return max(CONTEXT_CELLS_MAX, CONTEXT_CELLS_PER_CAMERA_MAX * cameras)
