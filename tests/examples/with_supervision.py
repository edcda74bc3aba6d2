"""Convert tracks of supervision: `python with_supervision.py VIDEO | camtopod ingest jsonl`."""

import sys

import numpy as np
import supervision as sv
from moving import Moving

from camtopod.client import TrackEvents
from camtopod.codec import to_json

video = Moving(sys.argv[1])
tracker = sv.ByteTrack(frame_rate=round(video.fps), minimum_matching_threshold=0.95)
tracks = TrackEvents("lobby", video.size)
for t, boxes in video:
    sure, kind = np.full(len(boxes), 0.9), np.zeros(len(boxes), int)
    found = tracker.update_with_detections(sv.Detections(boxes, confidence=sure, class_id=kind))
    for event in tracks.update(found.tracker_id, found.xyxy, t):
        print(to_json(event).decode(), flush=True)
for event in tracks.close():
    print(to_json(event).decode())
