"""Combine a tracker's own cost matrix with the site's prior: `python by_looks.py [ENDPOINT] <
seen.jsonl`.

Input lines are those of TrackEvents with an additional `"look"`: the embedding of a person by any
re-identification network.
"""

import json
import sys

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from camtopod import connect
from camtopod.codec import event_from_json

seen = [(event_from_json(line), json.loads(line)["look"]) for line in sys.stdin]
exits, left = zip(*[one for one in seen if one[0].kind == "exit"], strict=True)
entries, came = zip(*[one for one in seen if one[0].kind == "entry"], strict=True)
looks = 20 * (
    cdist(left, came, "cosine") - 0.4
)  # nats; neutral at 0.4: both figures depend on your network
with connect(connect=sys.argv[1:]) as site:
    zones = [site.predict(a.camera, a.t, x=a.x, y=a.y).zone for a in exits]
    gates = np.array(
        [[site.gate(zones[i], a.t, b.camera, b.t) for b in entries] for i, a in enumerate(exits)]
    )
    apart = -np.add.outer(
        [site.gate_gone(zone) for zone in zones], [site.gate_new(b.camera) for b in entries]
    )
cost = np.minimum(
    looks - gates - apart, 0
)  # (exits, entries): cost of being one person, over that of being two
for i, j in zip(*linear_sum_assignment(cost), strict=True):
    if cost[i, j] < 0:
        print(f"{exits[i].camera}/{exits[i].track} = {entries[j].camera}/{entries[j].track}")
