"""Tracks from blobs: what is one passage, and when its events are told."""

from __future__ import annotations

import numpy as np

from camtopod.records import Event
from camtopod.vision.boxes import Box
from camtopod.vision.detect import Blob
from camtopod.vision.settings import VisionSettings
from camtopod.vision.track import Crossings, IgnoredAreas, Tracker

WIDTH, HEIGHT = 320, 240
FPS = 7.0


def tracked(frames: list[list[Box]]) -> list[Event]:
    """Return the events of the boxes seen in each frame, and in some empty frames after them."""
    ignored = IgnoredAreas(np.full((HEIGHT, WIDTH), 255, np.uint8))
    crossings = Crossings("cam", WIDTH, HEIGHT, (), ignored, lambda decision: None)
    tracker = Tracker(VisionSettings(), crossings, iter(range(1, 1000)))
    crossings.began = 0.0
    events: list[Event] = []
    for k, boxes in enumerate([[], *frames, *[[]] * 10]):
        blobs = [Blob(*map(float, box), foot_x=(box[0] + box[2]) / 2) for box in boxes]
        events += tracker.step(k / FPS, blobs)
    return events


def test_what_moves_by_its_own_length_in_each_frame_is_one_passage() -> None:
    """A car of 50 x 25 pixels is assigned by its area: head and foot are outside every gate."""
    frames: list[list[Box]] = [
        [(max(0, x - 50), 100, min(WIDTH, x), 125)] for x in range(20, WIDTH + 50, 50)
    ]
    assert [event.kind for event in tracked(frames)] == ["entry", "exit"]
