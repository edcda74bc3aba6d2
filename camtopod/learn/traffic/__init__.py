"""The window's events labelled with zones: the departures and arrivals that the fits work on.

Reading order: `events` defines the tables of departures and arrivals; `labelled_events` fills them
from the window and the zone maps (`Scene`); `speed` estimates the slowness of objects and how far
it persists from view to view; `background_rate` has the rates of arrivals under the null model.
"""

from __future__ import annotations

from camtopod.learn.traffic.background_rate import NullRates, local_rates
from camtopod.learn.traffic.events import Arrivals, Departures
from camtopod.learn.traffic.labelled_events import Scene, ZoneRef, label_events
from camtopod.learn.traffic.speed import (
    NO_PERSISTENCE,
    SURE_RESPONSIBILITY,
    Persistence,
    adjusted_lag,
    agreement,
    estimate_persistence,
    mean_slowness,
    usual_dwell_times,
)

__all__ = [
    "NO_PERSISTENCE",
    "SURE_RESPONSIBILITY",
    "Arrivals",
    "Departures",
    "NullRates",
    "Persistence",
    "Scene",
    "ZoneRef",
    "adjusted_lag",
    "agreement",
    "estimate_persistence",
    "label_events",
    "local_rates",
    "mean_slowness",
    "usual_dwell_times",
]
