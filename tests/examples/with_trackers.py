"""Convert tracks of trackers (roboflow): `python with_trackers.py VIDEO | camtopod ingest jsonl`."""

import sys

import numpy as np
import supervision as sv
from moving import Moving
from trackers import ByteTrackTracker

from camtopod.client import TrackEvents
from camtopod.codec import to_json

video = Moving(sys.argv[1])
tracker = ByteTrackTracker(frame_rate=video.fps, minimum_consecutive_frames=1)
tracks = TrackEvents("lobby", video.size)
for t, boxes in video:
    sure, kind = np.full(len(boxes), 0.9), np.zeros(len(boxes), int)
    found = tracker.update(sv.Detections(boxes.astype(float), confidence=sure, class_id=kind))
    for event in tracks.update(found.tracker_id, found.xyxy, t):  # id -1: not tracked (yet)
        print(to_json(event).decode(), flush=True)
for event in tracks.close():
    print(to_json(event).decode())
