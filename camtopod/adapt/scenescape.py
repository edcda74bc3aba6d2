"""Events from SceneScape's ``scenescape/data/camera/{id}``: one message per frame of detections.

By SceneScape's schema a detection's ``id`` need not be the same in the next frame, and often it is
only a counter. Boxes are therefore linked here (`box_linking`), unless the caller declares that the
pipeline tracks objects (DL Streamer's gvatrack). Only boxes in pixels can be placed:
``bounding_box`` is in units of the lens, whose parameters are not in the message. Attributes (age,
licence plates, embeddings) are not read.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated

from msgspec import Meta, Struct

from camtopod import codec
from camtopod.adapt.adapter import Sizes, size_of, split_topic
from camtopod.adapt.box_linking import BoxLinker
from camtopod.adapt.camera_streams import Name, StreamAdapter, TrackedBox, seconds_of
from camtopod.codec import Rejected
from camtopod.records import Event


class _Pixels(Struct, frozen=True):
    x: float
    y: float
    width: Annotated[float, Meta(ge=0)]
    height: Annotated[float, Meta(ge=0)]


class _SceneScapeDetection(Struct, frozen=True):
    id: Name = None
    bounding_box_px: _Pixels | None = None


class _SceneScapeMessage(Struct, frozen=True):
    id: str
    timestamp: str
    objects: dict[str, list[_SceneScapeDetection]]


class SceneScape(StreamAdapter):
    """Adapter for camera detections: one JSON object a line, with or without the topic in front.

    sizes: sizes of the cameras' pictures.
    labels: kinds of objects (``person``) that count; empty for all.
    is_tracked: ids come from a tracker, so an object has the same id in each frame.
    """

    topic = "data/camera/+"
    box_form = "x, y, width, height in pixels"

    def __init__(
        self, sizes: Sizes, labels: Collection[str] = (), is_tracked: bool = False
    ) -> None:
        super().__init__(None, labels)
        self._sizes = sizes
        self._is_tracked = is_tracked

    def receive(self, line: bytes) -> list[Event]:
        """Return the events that a frame makes certain. Raises `Rejected`."""
        levels, text = split_topic(line, "*/data/camera/*")
        message = codec.read(_SceneScapeMessage, text)
        t = seconds_of(message.timestamp)
        camera = self.cameras.id_of(message.id, origin="/".join(levels[:-3]))
        stream = self._stream(camera, size_of(camera, self._sizes))

        # Boxes in pixels, named by the tracker's ids, or by linking.
        tracked_boxes = [
            TrackedBox(detection.id, (box.x, box.y, box.x + box.width, box.y + box.height), kind)
            for kind, detections in message.objects.items()
            for detection in detections
            if (box := detection.bounding_box_px) is not None
        ]
        if not tracked_boxes and any(message.objects.values()):
            raise Rejected("no-pixels", "no object has a bounding_box_px")
        names = [box.name for box in tracked_boxes if box.name is not None]
        if not self._is_tracked:
            stream.linker = stream.linker or BoxLinker()
        elif len(set(names)) < len(names):
            raise Rejected(
                "same-id", "two objects have one id, so they are not tracked: omit --tracked"
            )
        return stream.update(tracked_boxes, [], t)
