"""Predict the next camera of each object that leaves: `python next_camera.py [ENDPOINT] <
events.jsonl`.

Input lines are those of TrackEvents.
"""

import sys

from camtopod.client import Topology
from camtopod.codec import event_from_json

with Topology.connect(connect=sys.argv[1:]) as site:
    for event in map(event_from_json, sys.stdin):
        if event.kind == "exit":
            said = site.predict(event.camera, event.t, x=event.x, y=event.y, track=event.track)
            for n in said.next_[:1]:
                print(
                    f"{event.camera} -> {n.camera} {n.probability:.0%}, in {n.q10:.0f} to {n.q90:.0f} s",
                    flush=True,
                )
        site.observe(event)
