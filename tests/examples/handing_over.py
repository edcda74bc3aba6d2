"""Name the track in an overlapping view that continues: `python handing_over.py [ENDPOINT] <
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
            for n in (said.in_view or [])[:1]:
                print(
                    f"{event.camera}/{event.track} = {n.camera}/{n.track} {n.probability:.0%}",
                    flush=True,
                )
        site.observe(event)
