"""Candidates adjusted for speed: an object that was slow through one view takes longer to the next.

Lags are scaled by the slowness of the passages before and after, as far as speed persists at this
site, and a candidate whose two passages are equally slow is likelier to be of one object.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camtopod.arrays import Indices, Ints, Singles
from camtopod.learn.association.candidates import Candidates, slices_by_arrival
from camtopod.learn.traffic import (
    NO_PERSISTENCE,
    Arrivals,
    Departures,
    Persistence,
    adjusted_lag,
    agreement,
    mean_slowness,
)
from camtopod.topology import LagBins


class Adjusted(NamedTuple):
    """Candidates adjusted for speed.

    persistence: how speed persists from view to view.
    cell (M,): index in a flattened table (P, bins), by the lag at usual speed.
    agreement (M,): factor by which equal slowness before and after makes a candidate likelier; None
        where speed does not persist.
    """

    persistence: Persistence
    cell: Ints
    agreement: Singles | None

    def take(self, kept: Indices) -> Adjusted:
        """Return the candidates ``kept``; pairs of zones keep their numbers."""
        agreement = None if self.agreement is None else self.agreement[kept]
        return Adjusted(self.persistence, self.cell[kept], agreement)


def adjust(
    candidates: Candidates,
    departures: Departures,
    arrivals: Arrivals,
    found: Persistence,
    bins: LagBins,
) -> Adjusted:
    """Return the candidates adjusted by the ``found`` persistence of speed."""
    c = candidates
    cell = np.empty(len(c.lag), np.int32)
    agree = np.empty(len(c.lag), np.float32) if found.correlation > 0 else None

    for part in slices_by_arrival(c.arrival):
        lag = np.clip(c.lag[part].astype(float), bins.lag_min, bins.lag_max)
        if found != NO_PERSISTENCE:
            left = departures.slow.take(c.departure[part])
            came = arrivals.slow.take(c.arrival[part])
            lag = adjusted_lag(lag, mean_slowness(left, came), found.scaling, bins)
        cell[part] = c.pair[part] * bins.size + bins.index(lag)
        if agree is not None:
            agree[part] = agreement(left, came, found)

    return Adjusted(found, cell, agree)
