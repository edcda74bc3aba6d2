"""traffic"""

from __future__ import annotations

from camtopod.learn.traffic.background_rate import Chance, local_rates
from camtopod.learn.traffic.events import Arrivals, Departures
from camtopod.learn.traffic.labelled_events import Scene, ZoneRef, see
from camtopod.learn.traffic.speed import (
    NO_PERSISTENCE,
    SURE_RESPONSIBILITY,
    Persistence,
    adjusted_lag,
    agreement,
    combined,
    persistence,
    usual_stays,
)

__all__ = [
    "NO_PERSISTENCE",
    "SURE_RESPONSIBILITY",
    "Arrivals",
    "Chance",
    "Departures",
    "Persistence",
    "Scene",
    "ZoneRef",
    "adjusted_lag",
    "agreement",
    "combined",
    "local_rates",
    "persistence",
    "see",
    "usual_stays",
]
