"""Convert tracks of BoxMOT: `python with_boxmot.py VIDEO | camtopod ingest jsonl`."""

import sys

import numpy as np
from boxmot import ByteTrack
from moving import Moving

from camtopod.client import TrackEvents
from camtopod.codec import to_json

video = Moving(sys.argv[1])
tracks, tracker = TrackEvents("lobby", video.size), ByteTrack()
picture = np.zeros((int(video.size[1]), int(video.size[0]), 3), np.uint8)  # ByteTrack: no looks
for t, boxes in video:
    rest = np.tile([0.9, 0.0], (len(boxes), 1))  # confidence, class
    found = np.reshape(tracker.update(np.hstack([boxes, rest]), picture), (-1, 8))
    for event in tracks.update(found[:, 4], found[:, :4], t):  # left top right bottom id ...
        print(to_json(event).decode(), flush=True)
for event in tracks.close():
    print(to_json(event).decode())
