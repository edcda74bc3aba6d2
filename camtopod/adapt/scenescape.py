"""Events from SceneScape's ``scenescape/data/camera/{id}``: one message per frame of detections.

By SceneScape's schema a detection's ``id`` need not be the same in the next frame: the pipeline has
to track objects (DL Streamer's gvatrack). Only boxes in pixels can be placed: ``bounding_box`` is
in units of the lens, whose parameters are not in the message. Attributes (age, licence plates,
embeddings) are not read.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated

from msgspec import Meta, Struct

from camtopod import codec
from camtopod.adapt.adapter import Sizes, size_of, split_topic
from camtopod.adapt.camera_streams import Name, StreamAdapter, TrackedBox, seconds_of
from camtopod.codec import Rejected
from camtopod.records import CameraId, Event


class _Pixels(Struct, frozen=True):
    x: float
    y: float
    width: Annotated[float, Meta(ge=0)]
    height: Annotated[float, Meta(ge=0)]


class _Detection(Struct, frozen=True):
    id: Name = None
    bounding_box_px: _Pixels | None = None


class _Message(Struct, frozen=True):
    id: CameraId
    timestamp: str
    objects: dict[str, list[_Detection]]


class SceneScape(StreamAdapter):
    """Adapter for camera detections: one JSON object a line, with or without the topic in front.

    sizes: sizes of the cameras' pictures.
    labels: kinds of objects (``person``) that count; empty for all.
    """

    topic = "data/camera/+"

    def __init__(self, sizes: Sizes, labels: Collection[str] = ()) -> None:
        super().__init__(None, labels)
        self._sizes = sizes

    def receive(self, line: bytes) -> list[Event]:
        """Return the events that a frame makes certain. Raises `Rejected`."""
        message = codec.read(_Message, split_topic(line, "*/data/camera/*")[1])
        found = [(kind, one) for kind, these in message.objects.items() for one in these]
        seen = []
        for kind, one in found:
            if (box := one.bounding_box_px) is not None and one.id is not None:
                sides = (box.x, box.y, box.x + box.width, box.y + box.height)
                seen.append(TrackedBox(f"{kind}-{one.id}", sides, kind))
        if found and not seen:
            raise Rejected("no-pixels", "no object has an id and a bounding_box_px")
        stream = self._stream(message.id, size_of(message.id, self._sizes))
        return stream.update(seen, [], seconds_of(message.timestamp))
