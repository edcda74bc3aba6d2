"""Predict where and when an object that leaves a zone appears next, by one topology version.

Reading order: `predictor` takes events and returns predictions. `odds` computes the odds of the
possible next zones after an exit, from the version and from the observed arrivals. `hazards`,
`contexts` and `time_windows` read the version: rates of appearing by lag, the effect of an exit's
context, and time windows for an object of some speed. `outcomes` averages the version's two
opinions, and `anywhere` shares out what neither explains. `recent_events` and `open_passages` store
the observed events, by which `reporting` tells the cameras that are silent. `zone_lookup` finds the
zone of an event, and `hand_over` the other cameras that see the object at the exit. `walks` tells
which passages are of one object, by the `transitions` from each exit.
"""

from camtopod.predict.hand_over import seen_now as seen_now, sum_by_camera as sum_by_camera
from camtopod.predict.predictor import Predictor as Predictor, PredictorState as PredictorState
from camtopod.predict.transitions import Began as Began, Transitions as Transitions
from camtopod.predict.walks import Walks as Walks
