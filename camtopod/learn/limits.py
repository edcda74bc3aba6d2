"""What one fit may take, in counts: the same events give the same version on any machine, however
fast it is.

Theory of operation. Nearly all memory and time of a fit go into pairs of a departure and an arrival
within the range of lags, and into tables with a row for each pair of zones. The events of a window
are limited, but their pairs grow with the square of the traffic: 30,000 departures and as many
arrivals within five minutes are 900 million pairs. So each stage counts its pairs first, which is
cheap as times are sorted, and takes at most so many. Beyond that it leaves out the arrivals with
the most departures in reach (`clearest`): they tell the least, as each of them may have come from
anywhere, and they are those of the moments and places where a camera floods. What came at other
times is untouched, and so is everything on a site that stays below the limits: a hundred cameras of
ordinary traffic need a tenth of each.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Counts = NDArray[np.intp]

LOOKED_PER_EVENT_MAX = 400
"""Pairs counted in the look at one zone, for each event of the window."""
WEIGHED_MAX = 64_000_000
"""Pairs along the pairs of zones followed that screening weighs in one fit, ..."""
WEIGHED_AT_ONCE = 8_000_000
"""... and those of one zone of arrival that it weighs together: 50 bytes each."""
JUDGED_MAX = 6_000_000
"""Pairs by which the links that were found are judged in one fit (`crossfit`)."""
FOLLOWED_MAX = 5_000_000
"""Candidates that the fit for prediction follows (`posterior`)."""
ZONES_PER_CAMERA_MAX = 32
ZONE_PAIRS_MAX, ZONE_PAIRS_PER_CAMERA_MAX = 20_000, 250
"""Pairs of zones that are followed, at least, and for each camera if that is more."""
ENTRY_PAIRS_MAX, ENTRY_PAIRS_PER_CAMERA_MAX = 20_000, 600
"""Pairs of a zone of entry and one of the next appearance (`entering`), likewise."""
CONTEXT_CELLS_MAX, CONTEXT_CELLS_PER_CAMERA_MAX = 8_000_000, 40_000
"""Cells of a table with a row for each context of a departure (`contexts`), at least, and for each
camera if that is more."""


def clearest(reach: Counts, most: int) -> NDArray[np.bool_]:
    """Which arrivals (n,) count if their pairs may be at most ``most``: those with the fewest
    departures in ``reach`` (n,), the newest first of those with equally many.
    """
    kept = np.ones(len(reach), np.bool_)
    if int(reach.sum()) > most:
        order = np.lexsort((-np.arange(len(reach)), reach))
        kept[order[np.searchsorted(np.cumsum(reach[order]), most, side="right") :]] = False
    return kept


def fair_share(wanted: Counts, most: int) -> int:
    """What each of several (n,) may have at most for all together to have ``most``: who wants less
    leaves more.
    """
    order = np.sort(wanted)
    others = np.arange(len(order))[::-1]  # of those that want more
    too_much = np.flatnonzero(np.cumsum(order) + order * others > most)
    if len(too_much) == 0:
        return most
    k = int(too_much[0])
    return (most - int(order[:k].sum())) // (len(order) - k)


def zone_pairs_max(cameras: int) -> int:
    """Pairs of zones that are followed on a site of ``cameras``."""
    return max(ZONE_PAIRS_MAX, ZONE_PAIRS_PER_CAMERA_MAX * cameras)


def entry_pairs_max(cameras: int) -> int:
    """Pairs of a zone of entry and one of the next appearance on a site of ``cameras``."""
    return max(ENTRY_PAIRS_MAX, ENTRY_PAIRS_PER_CAMERA_MAX * cameras)


def context_cells_max(cameras: int) -> int:
    """Cells of a table with a row for each context of a departure, on a site with so many
    cameras.
    """
    return max(CONTEXT_CELLS_MAX, CONTEXT_CELLS_PER_CAMERA_MAX * cameras)
