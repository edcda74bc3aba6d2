"""Events from AXIS Scene Metadata by MQTT: frames of tracked objects.

Read are ``com.axis.scene.frame.v1`` (AXIS OS 12.8) and its forerunner
``com.axis.analytics_scene_description.v0.beta``, with fields as in Axis's Analytics Data Format
(developer.axis.com, "Frame", "Basic types"). Boxes are fractions of the picture, origin top left, y
down.

The device sends few frames while nothing moves. Tracks that a frame declares ended have left at
once. A head or a licence plate has an id of its own and is not counted beside its owner. Renames
are not followed. Colours, snapshots and plates are not read.
"""

from __future__ import annotations

import re

from msgspec import Struct, field

from camtopod import codec
from camtopod.adapt.adapter import split_topic
from camtopod.adapt.camera_streams import Name, StreamAdapter, TrackedBox, seconds_of
from camtopod.codec import Rejected
from camtopod.records import Event

_SOURCE = re.compile(r"(com\.axis|axis\.scene)\..*|frame(\.v\d.*)?")
"""A topic level that names the kind of data, not the camera."""


class _AxisBox(Struct, frozen=True):
    left: float
    top: float
    right: float
    bottom: float


class _AxisClass(Struct, frozen=True):
    type: str = ""


class _AxisDetection(Struct, frozen=True):
    bounding_box: _AxisBox | None = None
    object_track_id: Name = None
    track_id: Name = None
    """As ``object_track_id``, in the forerunner."""
    kind: _AxisClass = field(name="class", default=_AxisClass())


class _TrackEvent(Struct, frozen=True):
    type: str = ""
    object_track_id: Name = None
    id: Name = None
    """As ``object_track_id``, in the forerunner."""


class _AxisFrame(Struct, frozen=True):
    """A frame, or what it is in; of each pair of names the second is the forerunner's."""

    timestamp: str = ""
    channel_id: int = 1
    detections: list[_AxisDetection] | None = None
    observations: list[_AxisDetection] | None = None
    track_events: list[_TrackEvent] | None = None
    operations: list[_TrackEvent] | None = None
    frame: _AxisFrame | None = None
    data: _AxisFrame | None = None


class Axis(StreamAdapter):
    """Adapter for scene metadata: one JSON object a line, with or without the topic in front.

    camera: id of the one device's camera; None to take it from the topic: its last level, or the
        one before if the last names the data source. Channels from 2 on (a device with several
        sensors) have ``-CHANNEL`` behind it.
    labels: kinds of objects (``Human``, ``Car``) that count; empty for all.
    """

    outside_cause = "they are not in fractions of the picture"
    box_form = "left, top, right, bottom in fractions of the picture"

    def receive(self, line: bytes) -> list[Event]:
        """Return the events that a frame makes certain. Raises `Rejected`."""
        levels, text = split_topic(line)
        frame = codec.read(_AxisFrame, text)
        frame = frame.data or frame
        frame = frame.frame or frame
        boxes = frame.detections or frame.observations
        changes = frame.track_events or frame.operations
        parts = (frame.detections, frame.observations, frame.track_events, frame.operations)
        if not frame.timestamp or parts == (None, None, None, None):
            raise Rejected("malformed", "is no frame: has no timestamp, detections or track_events")

        # The camera.
        name_levels = [level for level in levels if not _SOURCE.fullmatch(level)]
        channel = f"-{frame.channel_id}" * (frame.channel_id > 1)
        origin = "/".join(name_levels[:-1])
        camera = self.cameras.id_of("".join(name_levels[-1:]), channel, origin)

        # Boxes, and the objects that are gone.
        tracked_boxes = []
        for detection in boxes or []:
            if (box := detection.bounding_box) is not None:
                name = _either(detection.object_track_id, detection.track_id)
                sides = (box.left, box.top, box.right, box.bottom)
                tracked_boxes.append(TrackedBox(name, sides, detection.kind.type))
        ended_names = [
            _either(change.object_track_id, change.id)
            for change in changes or []
            if change.type in ("TrackEnded", "DeleteOperation")
        ]
        return self._stream(camera).update(tracked_boxes, ended_names, seconds_of(frame.timestamp))


def _either(name: Name, forerunners: Name) -> Name:
    return forerunners if name is None else name
