"""Convert norfair's tracks: `python with_norfair.py VIDEO | camtopod ingest jsonl`."""

import sys

from moving import Moving
from norfair import Detection, Tracker

from camtopod.client import TrackEvents
from camtopod.codec import to_json

video = Moving(sys.argv[1])
tracker = Tracker("euclidean", video.size[1] / 8, initialization_delay=0)  # TrackEvents waits, too
tracks = TrackEvents("lobby", video.size)
for t, boxes in video:
    detections = [Detection(box.reshape(2, 2)) for box in boxes]
    seen = [x for x in tracker.update(detections) if x.last_detection in detections]  # not guessed
    for event in tracks.update([x.id for x in seen], [x.last_detection.points for x in seen], t):
        print(to_json(event).decode(), flush=True)
for event in tracks.close():
    print(to_json(event).decode())
