"""Predict where and when an object that leaves a zone appears next, by one topology version.

Reading order: `predictor` (events in, predictions out), `odds` (the outcomes of an exit, weighted
by what has been seen), `hazards`, `contexts`, `speed` and `time_windows` (what the version knows),
`recent_events` and `open_passages` (what has been observed), `zone_lookup` (zones of events), and
`hand_over` (which other cameras see the object at the exit).
"""

from __future__ import annotations

from camtopod.predict.contexts import ContextMultipliers
from camtopod.predict.hand_over import seen_now
from camtopod.predict.hazards import Hazards
from camtopod.predict.predictor import Predictor, PredictorState

__all__ = [
    "ContextMultipliers",
    "Hazards",
    "Predictor",
    "PredictorState",
    "seen_now",
]
