"""Predict where and when an object that leaves a zone appears next, by one topology version.

Reading order: `predictor` takes events and returns predictions. `outlook` is the one answer of what
becomes of an exit, from the version and from the observed arrivals; `version` holds what the
version says: `hazards` (rates of appearing by lag), `contexts` (the effect of an exit's context),
`time_windows` (windows for an object of some speed), `outcomes` and `second_opinion` (the version's
two opinions) and `anywhere` (what neither explains). `predictor_memory` has the observed events, in
`recent_events` and `passages`, and tells the cameras that are silent. `zone_lookup` finds the zone
of an event, and `hand_over` the other cameras that see the object at the exit. `walks`
tells which passages are of one object, by the outlook from each exit, with a `walk_memory` of its
own, as it keeps passages for an hour; from both follows how many objects are `between`
cameras. `city` asks the predictor, or the walks, of the district that owns a camera.
"""

from camtopod.predict.between import BetweenCameras as BetweenCameras
from camtopod.predict.city import (
    CityPredictor as CityPredictor,
    CityWalks as CityWalks,
    by_moment as by_moment,
    matching as matching,
    predicting as predicting,
)
from camtopod.predict.hand_over import cameras_to_watch as cameras_to_watch
from camtopod.predict.outlook import (
    Departure as Departure,
    Outlook as Outlook,
    log_density as log_density,
    outlook as outlook,
    outside_rates as outside_rates,
)
from camtopod.predict.passages import Passage as Passage
from camtopod.predict.predictor import Predictor as Predictor
from camtopod.predict.predictor_memory import PredictorState as PredictorState
from camtopod.predict.recent_events import RECENT_MAX as RECENT_MAX
from camtopod.predict.version import PreparedVersion as PreparedVersion
from camtopod.predict.walks import Walks as Walks
