"""Convert Ultralytics' tracks: `python with_ultralytics.py VIDEO | camtopod ingest jsonl`."""

import sys

from moving import Moving
from ultralytics import YOLO

from camtopod.client import TrackEvents
from camtopod.codec import to_json

video = Moving(sys.argv[1])  # for its size and frame rate only
tracks = TrackEvents("lobby", video.size)
results = YOLO("yolo11n.pt").track(sys.argv[1], stream=True, persist=True, classes=[0])  # people
for number, result in enumerate(results):
    boxes = result.boxes.cpu().numpy()  # id is None while nothing is tracked
    for event in tracks.update(boxes.id, boxes.xyxy, number / video.fps):
        print(to_json(event).decode(), flush=True)
for event in tracks.close():
    print(to_json(event).decode())
