"""predict"""

from __future__ import annotations

from camtopod.predict.contexts import Surroundings
from camtopod.predict.hand_over import seen_now
from camtopod.predict.hazards import Hazards
from camtopod.predict.predictor import Predictor, PredictorState

__all__ = [
    "Hazards",
    "Predictor",
    "PredictorState",
    "Surroundings",
    "seen_now",
]
