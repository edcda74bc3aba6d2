"""Predict the next camera of each object that leaves: `python next_camera.py [ENDPOINT] <
events.jsonl`.

Input lines are those of TrackEvents.
"""

import sys

from camtopod import connect
from camtopod.codec import event_from_json

with connect(connect=sys.argv[1:]) as site:
    for event in map(event_from_json, sys.stdin):
        if event.kind == "exit":
            said = site.predict(event.camera, event.t, x=event.x, y=event.y, track=event.track)
            print(f"{event.camera} -> {said}", flush=True)
        site.observe(event)
