"""Events from AXIS Scene Metadata by MQTT: frames of tracked objects, or whole tracks.

- ``com.axis.scene.frame.v1`` (AXIS OS 12.8): the objects of one frame. Its forerunner
  ``com.axis.analytics_scene_description.v0.beta`` is read, too.
- ``com.axis.scene.object_track.v1``: one object with its path, sent after it has left. Its
  forerunner ``com.axis.consolidated_track.v1.beta`` is read, too. An entry is then as old as the
  passage is long: too old for a daemon whose lateness is shorter.

Fields as in Axis's Analytics Data Format (developer.axis.com, "Frame", "Object Track", "Basic
types"). Boxes of both are fractions of the picture, origin top left, y down. What differs is where
they are: in a frame beside the object's id, in a track in the samples of ``path``.

The device sends few frames while nothing moves. Tracks that a frame declares ended have left at
once. A head or a licence plate has an id of its own and is not counted beside its owner. Renames
are not followed. Colours, snapshots and plates are not read.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from msgspec import Struct, field

from camtopod import codec
from camtopod.adapt.adapter import REMEMBERED_MAX, checked, remember
from camtopod.adapt.camera_streams import (
    Box,
    Name,
    StreamAdapter,
    TrackedBoxes,
    likeliest,
    seconds_of,
    split_topic,
)
from camtopod.adapt.tracks import LIFE_SECONDS
from camtopod.codec import TRACK_CHARACTERS_MAX, Rejected
from camtopod.records import Event, Kind

_SOURCES = ("com.axis.", "axis.scene.", "frame", "object_track")
"""Beginnings of a last topic level that names the kind of data, not the camera."""


class _Box(Struct, frozen=True):
    left: float
    top: float
    right: float
    bottom: float

    def corners(self) -> Box:
        return self.left, self.top, self.right, self.bottom


class _Class(Struct, frozen=True):
    type: str = ""
    score: float | None = None


class _Detection(Struct, frozen=True):
    bounding_box: _Box | None = None
    object_track_id: str | int | None = None
    track_id: str | int | None = None
    """As ``object_track_id``, in the forerunner."""
    kind: _Class = field(name="class", default=_Class())

    @property
    def name(self) -> Name:
        return self.track_id if self.object_track_id is None else self.object_track_id


class _TrackEvent(Struct, frozen=True):
    type: str = ""
    object_track_id: str | int | None = None
    id: str | int | None = None
    """As ``object_track_id``, in the forerunner."""

    @property
    def name(self) -> Name:
        return self.id if self.object_track_id is None else self.object_track_id


class _Frame(Struct, frozen=True):
    """A frame; of each pair of names the second is the forerunner's."""

    timestamp: str
    channel_id: int = 1
    detections: list[_Detection] = []
    observations: list[_Detection] = []
    track_events: list[_TrackEvent] = []
    operations: list[_TrackEvent] = []


class _Sample(Struct, frozen=True):
    timestamp: str
    bounding_box: _Box | None = None


class _Track(Struct, frozen=True):
    id: str | int
    channel_id: int = 1
    classes: list[_Class] = []
    path: list[_Sample] = []
    observations: list[_Sample] = []
    """As ``path``, in the forerunner."""


class _Form(Struct, frozen=True):
    """What tells the messages apart."""

    timestamp: str | None = None
    frame: _Frame | None = None
    data: _Form | None = None
    id: str | int | None = None


class _FrameIn(Struct, frozen=True):
    frame: _Frame


class _DataIn(Struct, frozen=True):
    data: _FrameIn


class Axis(StreamAdapter):
    """Adapter for scene metadata: one JSON object a line, with or without the topic in front.

    camera: id of the one device's camera; None to take it from the topic: its last level, or the
        one before if the last names the data source. Channels from 2 on (a device with several
        sensors) have ``-CHANNEL`` behind it.
    labels: kinds of objects (``Human``, ``Car``) that count; empty for all.
    """

    def __init__(self, camera: str | None = None, labels: Collection[str] = ()) -> None:
        super().__init__(camera, labels)
        self._with_frames: set[str] = set()
        self._reported: dict[tuple[str, str | int], None] = {}

    def receive(self, line: bytes) -> list[Event]:
        """Return the events that a message makes certain. Raises `Rejected`."""
        levels, message = split_topic(line)
        form = codec.read(_Form, message)
        if form.data is not None:
            return self._frame(codec.read(_DataIn, message).data.frame, levels)
        if form.frame is not None:
            return self._frame(form.frame, levels)
        if form.timestamp is not None:
            return self._frame(codec.read(_Frame, message), levels)
        if form.id is not None:
            return self._whole(codec.read(_Track, message), levels)
        raise Rejected("malformed", "is neither a frame nor an object track")

    def _frame(self, frame: _Frame, levels: Sequence[str]) -> list[Event]:
        """Return the events of a frame. Raises `Rejected`."""
        camera = self._camera(levels, frame.channel_id)
        t = seconds_of(frame.timestamp)
        seen = TrackedBoxes()
        for one in frame.detections or frame.observations:
            if one.bounding_box is not None:
                seen.add(one.name, one.bounding_box.corners(), one.kind.type)
        ended = [
            change.name
            for change in frame.track_events or frame.operations
            if change.type in ("TrackEnded", "DeleteOperation")
        ]
        self._with_frames.add(camera)
        return self._streams.at(camera, (1, 1)).update(seen, ended, t)

    def _whole(self, track: _Track, levels: Sequence[str]) -> list[Event]:
        """Return the entry and exit of a whole track. Raises `Rejected`."""
        camera = self._camera(levels, track.channel_id)
        if camera in self._with_frames:
            raise Rejected("two-sources", "this camera's frames are read: publish one of the two")

        # The first and the last sample with a box.
        samples = [
            (seconds_of(sample.timestamp), sample.bounding_box.corners())
            for sample in track.path or track.observations
            if sample.bounding_box is not None
        ]
        if not samples:
            raise Rejected("no-box", "no sample of the path has a bounding_box")
        first = min(samples)
        last = max(samples)

        # Once, if it is an object that counts.
        key = (camera, track.id)
        kind = likeliest([(one.score, one.type) for one in track.classes])
        if (
            key in self._reported
            or last[0] - first[0] < LIFE_SECONDS
            or not self._streams.wants(kind)
        ):
            return []
        entry = _event(camera, "entry", first, track.id)
        events = checked([entry, _event(camera, "exit", last, track.id)])
        remember(self._reported, key, None, REMEMBERED_MAX)
        return events

    def _camera(self, levels: Sequence[str], channel: int) -> str:
        """Return the camera's id. Raises `Rejected`."""
        named = [level for level in levels if not level.startswith(_SOURCES)]
        camera = self._streams.name(named[-1] if named else "")
        return camera if channel <= 1 else f"{camera}-{channel}"


def _event(camera: str, kind: Kind, sample: tuple[float, Box], name: str | int) -> Event:
    """Return an event at the bottom centre of a sample's box."""
    t, (left, _, right, bottom) = sample
    x = round(min(max((left + right) / 2, 0.0), 1.0), 4)
    y = round(min(max(bottom, 0.0), 1.0), 4)
    return Event(camera, kind, t, x, y, str(name)[:TRACK_CHARACTERS_MAX])
