"""Events from NVIDIA DeepStream's messages (Gst-nvmsgconv): full and minimal schema.

- Minimal: one message a frame, ``objects`` a list of strings
  ``id|left|top|right|bottom|Type|#|...``; the camera is ``sensorId``.
- Full: one message an object, with ``object.id`` and ``object.bbox``; the camera is ``sensor.id``.

As in the page "Gst-nvmsgconv" of DeepStream's documentation (looked up for 5.0 to 9.2). Boxes are
pixels, so the size of the pictures is needed: the source's, to which deepstream-app and
deepstream-test5 scale boxes back, or the stream muxer's where a program (deepstream-test4) does
not.
``@timestamp`` is ISO 8601; seconds and milliseconds since the epoch are read, too. Attributes
behind the type (plates, ages) are not read.
"""

from __future__ import annotations

from collections.abc import Collection

from msgspec import Struct, field

from camtopod import codec
from camtopod.adapt.adapter import Sizes, size_of, split_topic
from camtopod.adapt.camera_streams import Name, StreamAdapter, TrackedBox, seconds_of
from camtopod.codec import Rejected
from camtopod.records import Event

_UNTRACKED = ("", "-1", str(2**64 - 1))
"""Ids of objects that DeepStream's tracker does not follow."""


class _Sensor(Struct, frozen=True):
    id: str | int = ""


class _DeepStreamBox(Struct, frozen=True):
    left: float = field(name="topleftx")
    top: float = field(name="toplefty")
    right: float = field(name="bottomrightx")
    bottom: float = field(name="bottomrighty")


class _DeepStreamObject(Struct, frozen=True):
    id: str | int
    bbox: _DeepStreamBox | None = None
    person: object = None
    vehicle: object = None
    face: object = None
    type: str = ""

    def kind(self) -> str:
        """Return the kind: the full schema has a member of that name."""
        members = {"Person": self.person, "Vehicle": self.vehicle, "Face": self.face}
        return self.type or next(
            (name for name, member in members.items() if member is not None), ""
        )


class _DeepStreamMessage(Struct, frozen=True):
    time: str | int | float = field(name="@timestamp")
    sensorId: str | int = ""
    objects: list[str] | None = None
    sensor: _Sensor = _Sensor()
    object: _DeepStreamObject | None = None


class DeepStream(StreamAdapter):
    """Adapter for both schemas: one JSON object a line, with or without the topic in front.

    sizes: sizes of the pictures that the boxes refer to.
    camera: id of the one camera; None to take it from the messages.
    labels: kinds of objects (``Person``) that count; empty for all.
    """

    def __init__(
        self, sizes: Sizes, camera: str | None = None, labels: Collection[str] = ()
    ) -> None:
        super().__init__(camera, labels)
        self._sizes = sizes

    def receive(self, line: bytes) -> list[Event]:
        """Return the events that a message makes certain. Raises `Rejected`."""
        levels, text = split_topic(line)
        message = codec.read(_DeepStreamMessage, text)
        sensor = message.sensor.id
        if message.sensorId != "":
            sensor = message.sensorId
        camera = self.cameras.id_of(str(sensor), origin="/".join(levels))
        lone_object = message.object
        if message.objects is None and lone_object is None:
            raise Rejected("malformed", "has neither objects nor object")

        # The objects of the frame, or the one object.
        tracked_boxes = [_object(text) for text in message.objects or []]
        if lone_object is not None:
            if lone_object.bbox is None:
                raise Rejected("no-box", "the object has no bbox")
            box = lone_object.bbox
            sides = (box.left, box.top, box.right, box.bottom)
            tracked_boxes.append(TrackedBox(_name(lone_object.id), sides, lone_object.kind()))
        stream = self._stream(camera, size_of(camera, self._sizes))
        return stream.update(tracked_boxes, [], seconds_of(message.time))


def _object(text: str) -> TrackedBox:
    """Return the object of a string. Raises `Rejected`."""
    name, *sides, kind = (text + "|").split("|")[:6]
    try:
        left, top, right, bottom = map(float, sides)
    except ValueError:
        raise Rejected("malformed", "an object is not id|left|top|right|bottom|...") from None
    return TrackedBox(_name(name), (left, top, right, bottom), kind)


def _name(identifier: str | int) -> Name:
    """Return the name of a track; None if the object is not tracked."""
    name = str(identifier).strip()
    return None if name in _UNTRACKED else name
