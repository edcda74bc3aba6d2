"""The association problem: departures and arrivals of a window, some of which are of one object."""

from __future__ import annotations

from typing import NamedTuple

from camtopod.learn.traffic import Arrivals, Departures
from camtopod.topology import LagBins


class Problem(NamedTuple):
    """Departures and arrivals, of which the fits estimate which are of one object."""

    departures: Departures
    arrivals: Arrivals
    bins: LagBins
    """Bins of the lags from a departure to an arrival."""
    zones: int
    """Number of zones; zones of departure and arrival are numbered from 0."""
    until: float
    """End of the window, seconds: later arrivals could not be seen."""
