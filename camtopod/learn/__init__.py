"""Learn a camera network topology from entry and exit events.

Deterministic: no I/O, no clock, no threads, and every random draw has a fixed seed, so the same
events give the same versions. In the order in which data flows, which is a good order to read:

* `zones`: the entry and exit zones of each view, `camera_zones`: those of all cameras
* `window`: events put in order of time, and the sliding window of those that count
* `traffic`: these events by zone, as departures, arrivals and passages; background rates; speed
* `clocks`: the clock offset of each camera
* `association`: candidates (a departure and an arrival that may be of one object) and the joint fit
  of their responsibilities
* `links`: significance, transit times and missed detections; which links are published
* `changes`: links that open or close, cameras that move or fall silent; alarms
* `next_camera`: the posterior for prediction, weak evidence included; `paths`: a second opinion
* `declarations`: what the user has declared of neighbours
* `refit`: `association` to `paths` as one pure function; `lag_range` finds how far the joint fit
  looks, `long_paths` extends it
* `learner`: decides when to refit and turns the results into versions, within `settings` and
  `limits`; `assemble` and `prediction_model` make the records of a version
* `outcomes` and `self_score`: scores of past predictions
* `snapshot`, `rewinding`, `renaming` and `retired_cameras`: save the state, take event time back,
  rename a camera, forget cameras; `doubled_cameras`: those that two programs publish
"""
