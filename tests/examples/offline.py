"""Tell which tracks are of one object, without a daemon: `python offline.py LEARN.jsonl MATCH.jsonl`.

The first file is learned, the second one matched; their lines are those of TrackEvents.
"""

import sys

import numpy as np
from scipy.optimize import linear_sum_assignment

from camtopod import Gate, learn_topology
from camtopod.codec import event_from_json


def read(path: str, kind: str = "") -> list:
    with open(path, "rb") as lines:
        return [event for event in map(event_from_json, lines) if event.kind.startswith(kind)]


gate = Gate(learn_topology(read(sys.argv[1])))  # or Gate(load_topology("topology.json"))
exits, entries = read(sys.argv[2], "exit"), read(sys.argv[2], "entry")
odds = gate.affinity(exits, entries)  # log odds (exits, entries), nats: add those of appearance
for i, j in zip(*linear_sum_assignment(np.maximum(odds, 0), maximize=True), strict=True):
    if odds[i, j] > 0:
        print(f"{exits[i].camera}/{exits[i].track} = {entries[j].camera}/{entries[j].track}")
