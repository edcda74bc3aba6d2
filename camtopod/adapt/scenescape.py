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
from camtopod.adapt.adapter import Sizes, payload, size_of
from camtopod.adapt.box_linking import BoxLinker
from camtopod.adapt.camera_streams import Box, Name, StreamAdapter, TrackedBoxes, seconds_of
from camtopod.codec import Rejected
from camtopod.records import CameraId, Event


class _Pixels(Struct, frozen=True):
    x: float
    y: float
    width: Annotated[float, Meta(ge=0)]
    height: Annotated[float, Meta(ge=0)]

    def corners(self) -> Box:
        return self.x, self.y, self.x + self.width, self.y + self.height


class _Detection(Struct, frozen=True):
    id: int | str | None = None
    bounding_box_px: _Pixels | None = None


class _Message(Struct, frozen=True):
    id: CameraId
    timestamp: str
    objects: dict[str, list[_Detection]]


class SceneScape(StreamAdapter):
    """Adapter for camera detections: one JSON object a line, with or without the topic in front.

    sizes: sizes of the cameras' pictures.
    labels: kinds of objects (``person``) that count; empty for all.
    tracked: ids come from a tracker, so an object has the same id in each frame.
    """

    topic = "data/camera/+"

    def __init__(self, sizes: Sizes, labels: Collection[str] = (), tracked: bool = False) -> None:
        super().__init__(None, labels)
        self._sizes = sizes
        self._tracked = tracked
        self._linkers: dict[str, BoxLinker] = {}

    def receive(self, line: bytes) -> list[Event]:
        """Return the events that a frame makes certain. Raises `Rejected`."""
        message = codec.read(_Message, payload(line, self.topic))
        t = seconds_of(message.timestamp)
        camera = message.id
        stream = self._streams.at(camera, size_of(camera, self._sizes))
        stream.require_newer(t)  # before its boxes are linked to those of later frames

        # Boxes in pixels, of the kinds that count.
        wanted = {kind: them for kind, them in message.objects.items() if self._streams.wants(kind)}
        found = [(kind, one) for kind, them in wanted.items() for one in them]
        kinds = [kind for kind, one in found if one.bounding_box_px is not None]
        ids = [one.id for _, one in found if one.bounding_box_px is not None]
        boxes = [one.bounding_box_px.corners() for _, one in found if one.bounding_box_px]
        if found and not boxes:
            raise Rejected("no-pixels", "no object has a bounding_box_px")

        # Names by the tracker's ids, or by linking.
        seen = TrackedBoxes()
        names: list[Name] = list(ids)
        if not self._tracked:
            names = list(self._linkers.setdefault(camera, BoxLinker()).link(kinds, boxes, t))
        for kind, name, box in zip(kinds, names, boxes, strict=True):
            seen.add(None if name is None else f"{kind}-{name}", box, kind)
        return stream.update(seen, [], t)
