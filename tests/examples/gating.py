"""Match exits with entries of the same objects: `python gating.py [ENDPOINT] < events.jsonl`.

Input lines are those of TrackEvents.
"""

import sys

import numpy as np
from scipy.optimize import linear_sum_assignment

from camtopod import connect
from camtopod.codec import event_from_json

events = [event_from_json(line) for line in sys.stdin]
exits = [event for event in events if event.kind == "exit"]
entries = [event for event in events if event.kind == "entry"]
with connect(connect=sys.argv[1:]) as site:
    odds = site.affinity(exits, entries)  # log odds (exits, entries); add other evidence here
for i, j in zip(*linear_sum_assignment(np.maximum(odds, 0), maximize=True), strict=True):
    if odds[i, j] > 0:
        print(f"{exits[i].camera}/{exits[i].track} = {entries[j].camera}/{entries[j].track}")
