"""Events from SceneScape's ``scenescape/data/camera/{id}``: one message per frame of detections.

By SceneScape's schema a detection's ``id`` need not be the same in the next frame, and often it is
only a counter. Boxes are therefore linked here (`box_linking`), unless the caller declares that the
pipeline tracks objects (DL Streamer's gvatrack). Only boxes in pixels can be placed:
``bounding_box`` is in units of the lens, whose parameters are not in the message. Attributes (age,
licence plates, embeddings) are not read.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from datetime import UTC, datetime
from typing import Annotated

from msgspec import Meta, Struct

from camtopod import codec
from camtopod.adapt.adapter import Sizes, checked, payload, size_of
from camtopod.adapt.box_linking import Box, BoxLinker
from camtopod.adapt.tracks import TrackEvents
from camtopod.codec import Rejected
from camtopod.records import CameraId, Event

CAMERAS_MAX = 1000
"""Cameras followed; messages of further ones are refused."""
OBJECTS_MAX = 1000
"""Objects accepted in a frame."""
KINDS_MAX = 100
"""Kinds of objects followed in a camera; objects of further kinds are ignored."""


class _Pixels(Struct, frozen=True):
    x: float
    y: float
    width: Annotated[float, Meta(ge=0)]
    height: Annotated[float, Meta(ge=0)]


class _Detection(Struct, frozen=True):
    id: int | str | None = None
    bounding_box_px: _Pixels | None = None


class _Message(Struct, frozen=True):
    id: CameraId
    timestamp: datetime
    objects: dict[str, list[_Detection]]


class _Camera:
    """Tracks of one camera, and the linker of boxes of each kind."""

    def __init__(self, camera: str, size: tuple[int, int]) -> None:
        self.tracks = TrackEvents(camera, size)
        self._linkers: dict[str, BoxLinker] = {}

    def names(self, kind: str, boxes: Sequence[Box], t: float) -> list[str | None]:
        """Link boxes of a kind to earlier ones; return the name of each box's track."""
        linker = self._linkers.get(kind)
        if linker is None:
            if len(self._linkers) >= KINDS_MAX:
                return [None] * len(boxes)
            linker = self._linkers[kind] = BoxLinker()
        return [None if number is None else f"{kind}-{number}" for number in linker.link(boxes, t)]


class SceneScape:
    """Adapter for camera detections: one JSON object a line, with or without the topic in front.

    sizes: sizes of the cameras' pictures.
    labels: kinds of objects (``person``) that count; empty for all.
    tracked: ids come from a tracker, so an object has the same id in each frame.
    """

    topic = "data/camera/+"

    def __init__(self, sizes: Sizes, labels: Collection[str] = (), tracked: bool = False) -> None:
        self._sizes = sizes
        self._labels = frozenset(labels)
        self._tracked = tracked
        self._cameras: dict[str, _Camera] = {}

    def receive(self, line: bytes) -> list[Event]:
        """Return the events that a frame makes certain. Raises `Rejected`."""
        message = codec.read(_Message, payload(line, self.topic))
        t = message.timestamp
        seconds = (t if t.tzinfo else t.replace(tzinfo=UTC)).timestamp()
        if not codec.T_MIN <= seconds < codec.T_MAX:
            raise Rejected("bad-value", "timestamp is not between 1970 and 3000 - at `$.timestamp`")

        if sum(map(len, message.objects.values())) > OBJECTS_MAX:
            raise Rejected("too-many", f"more than {OBJECTS_MAX} objects in a frame")

        camera = self._camera(message.id)
        if camera.tracks.is_late(seconds):  # before its boxes are linked to those of later frames
            raise Rejected("out-of-order", "a later frame of this camera came before")
        names, boxes = self._followed(camera, message, seconds)
        return checked(camera.tracks.update(names, boxes, seconds))

    def close(self) -> list[Event]:
        """Return the exits of objects out of sight. Those in a camera's last frame are in view."""
        return checked(
            event for camera in self._cameras.values() for event in camera.tracks.close()
        )

    def _followed(
        self, camera: _Camera, message: _Message, t: float
    ) -> tuple[list[str | None], list[Box]]:
        """Return track names and boxes of the objects of a frame that count. Raises `Rejected`."""
        names: list[str | None] = []
        boxes: list[Box] = []
        unplaced = 0

        for kind, detections in message.objects.items():
            if self._labels and kind not in self._labels:
                continue

            # Boxes in pixels.
            placed = [
                (x.id, _box(x.bounding_box_px)) for x in detections if x.bounding_box_px is not None
            ]
            unplaced += len(detections) - len(placed)

            # Names by the tracker's ids, or by linking.
            here = [box for _, box in placed]
            boxes += here
            if self._tracked:
                names += [None if number is None else f"{kind}-{number}" for number, _ in placed]
            else:
                names += camera.names(kind, here, t)
        if unplaced and not boxes:
            raise Rejected("no-pixels", "no object has a bounding_box_px")
        return names, boxes

    def _camera(self, name: str) -> _Camera:
        """Return the state of a camera, new or known. Raises `Rejected`."""
        camera = self._cameras.get(name)
        if camera is None:
            if len(self._cameras) >= CAMERAS_MAX:
                raise Rejected("too-many-cameras", f"more than {CAMERAS_MAX} cameras")
            camera = self._cameras[name] = _Camera(name, size_of(name, self._sizes))
        return camera


def _box(pixels: _Pixels) -> Box:
    return pixels.x, pixels.y, pixels.x + pixels.width, pixels.y + pixels.height
