"""Tracks of several cameras in one stream: camera, time and boxes of each message.

Shared by `axis`, `onvif`, `deepstream` and `scenescape`, whose messages are frames with boxes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Sequence
from datetime import UTC, datetime

from camtopod import codec
from camtopod.adapt.adapter import REMEMBERED_MAX, Size, checked, remember
from camtopod.adapt.tracks import TRACKS_MAX, TrackEvents
from camtopod.codec import Rejected
from camtopod.records import CAMERA_PATTERN, Event

STREAMS_MAX = 1000
"""Cameras (or analytics modules of cameras) followed; messages of further ones are refused."""
SILENT_SECONDS = 2.5
"""Time without a frame after which a camera's objects have left.

Many sources send nothing while the view is empty. An exit that waited for the next frame would be
too late to be learned.
"""
PARTS = frozenset({"head", "face", "humanface", "licenseplate"})
"""Kinds of boxes that are part of an object, in lower case.

They have ids of their own: a person whose head is tracked too would count twice.
"""

Box = tuple[float, float, float, float]
"""Left, top, right, bottom."""
Name = str | int | None
"""Id of a track; None for a box that the tracker does not follow."""


class TrackedBoxes:
    """A frame's tracked boxes: ids, boxes (units of the stream's ``size``) and kinds."""

    def __init__(self) -> None:
        self.names: list[Name] = []
        self.boxes: list[Box] = []
        self.kinds: list[str] = []
        """Kind of each box; empty if it is unknown."""

    def add(self, name: Name, box: Box, kind: str) -> None:
        """Add a box. Raises `Rejected` if the frame has too many."""
        if len(self.names) >= TRACKS_MAX:
            raise Rejected("too-many", f"more than {TRACKS_MAX} objects in a frame")
        self.names.append(name)
        self.boxes.append(box)
        self.kinds.append(kind)


class CameraStream:
    """Tracks of one camera, or of one analytics module of a camera."""

    def __init__(self, camera: str, size: Size, labels: Collection[str]) -> None:
        self._tracks = TrackEvents(camera, size)
        self._labels = labels
        self._kinds: dict[Name, str] = {}
        """Latest known kind of each track: trackers do not classify an object in each frame."""
        self.arrived = 0.0
        """When the latest frame came, seconds of the clock of `CameraStreams.silent`."""

    def lose(self) -> list[Event]:
        """Return the exits of all objects, as the camera is silent."""
        return checked(self._tracks.lose())

    def update(self, seen: TrackedBoxes, ended: Iterable[Name], t: float) -> list[Event]:
        """Return the events that a frame at ``t`` (seconds) makes certain.

        ended: tracks that the tracker reports as ended.

        Raises `Rejected` if a later frame came before.
        """
        self.require_newer(t)

        # Boxes of the wanted kinds, or of all that are no part of another object.
        names: list[Name] = []
        boxes: list[Box] = []
        for name, box, kind in zip(seen.names, seen.boxes, seen.kinds, strict=True):
            if counts(self._kind(name, kind), self._labels):
                names.append(name)
                boxes.append(box)

        # Events.
        events = self._tracks.update(names, boxes, t)
        for name in ended:
            self._kinds.pop(name, None)
            events += self._tracks.end(name)
        return checked(events)

    def require_newer(self, t: float) -> None:
        """Raise `Rejected` if a frame at ``t`` comes after a later one."""
        if self._tracks.is_late(t):
            raise Rejected("out-of-order", "a later frame of this camera came before")

    def close(self) -> list[Event]:
        """Return the exits of objects out of sight in the last frame."""
        return checked(self._tracks.close())

    def _kind(self, name: Name, kind: str) -> str:
        """Remember the kind of a track; return the latest one known."""
        kind = kind or self._kinds.get(name, "")
        if name is not None and kind:
            remember(self._kinds, name, kind, REMEMBERED_MAX)
        return kind


class CameraStreams:
    """The streams of all cameras.

    camera: the one camera's id; None if the messages or their topics name the cameras.
    labels: kinds of objects that count, whatever their case; empty for all.
    """

    def __init__(self, camera: str | None, labels: Collection[str]) -> None:
        self._camera = camera
        self._named: str | None = None
        """What the messages call the one camera."""
        self._labels = frozenset(label.lower() for label in labels)
        self._streams: dict[tuple[str, str], CameraStream] = {}
        self._now = self._checked = 0.0

    def name(self, given: str) -> str:
        """Return the camera's id: the one camera's, or ``given``. Raises `Rejected`."""
        if self._camera is not None:
            if self._named is None:
                self._named = given
            if given != self._named:
                raise Rejected("other-camera", "another camera than the first: omit --camera")
            return self._camera
        if not re.match(CAMERA_PATTERN, given):
            raise Rejected("no-camera", "names no camera: give --camera ID")
        return given

    def wants(self, kind: str) -> bool:
        """Return True if objects of this kind count."""
        return counts(kind, self._labels)

    def at(self, camera: str, size: Size, module: str = "") -> CameraStream:
        """Return the stream of a camera's analytics module, new or known. Raises `Rejected`."""
        stream = self._streams.get((camera, module))
        if stream is None:
            if len(self._streams) >= STREAMS_MAX:
                raise Rejected("too-many-cameras", f"more than {STREAMS_MAX} cameras")
            stream = CameraStream(camera, size, self._labels)
            self._streams[camera, module] = stream
        stream.arrived = self._now
        return stream

    def silent(self, now: float) -> list[Event]:
        """Return the exits of the objects of cameras that have sent no frame for `SILENT_SECONDS`.

        now: seconds of a clock that runs evenly. To be called before each message that comes live,
        and often in between. Without calls no camera counts as silent.
        """
        self._now = now
        if now - self._checked < SILENT_SECONDS / 5:
            return []
        self._checked = now
        silent = (one for one in self._streams.values() if now - one.arrived > SILENT_SECONDS)
        return [event for stream in silent for event in stream.lose()]

    def close(self) -> list[Event]:
        """Return the exits of objects out of sight, of all cameras."""
        return [event for stream in self._streams.values() for event in stream.close()]


class StreamAdapter:
    """Common part of adapters whose messages are frames of several cameras.

    camera: id of the one camera; None if the messages or their topics name the cameras.
    labels: kinds of objects that count; empty for all.
    """

    topic = "#"

    def __init__(self, camera: str | None = None, labels: Collection[str] = ()) -> None:
        self._streams = CameraStreams(camera, labels)

    def silent(self, now: float) -> list[Event]:
        """Return the exits in cameras that are silent, see `CameraStreams.silent`."""
        return self._streams.silent(now)

    def close(self) -> list[Event]:
        """Return the exits of objects out of sight. Those in a camera's last frame are in view."""
        return self._streams.close()


def counts(kind: str, labels: Collection[str]) -> bool:
    """Return True if an object of this kind counts.

    labels: the kinds that count, in lower case; empty for all that are no part of another object.
    """
    return kind.lower() in labels if labels else kind.lower() not in PARTS


def likeliest(kinds: Sequence[tuple[float | None, str]]) -> str:
    """Return the kind with the highest likelihood (likelihood, kind); empty if there is none."""
    return max(kinds, key=lambda kind: kind[0] or 0.0, default=(0.0, ""))[1]


def seconds_of(value: str | float) -> float:
    """Return the seconds since the epoch of a time; raise `Rejected` if it is none.

    value: ISO 8601 (UTC if it names no zone), or milliseconds since the epoch.
    """
    if isinstance(value, str):
        try:
            moment = datetime.fromisoformat(value.strip())
            t = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
        except (ValueError, OverflowError):
            raise Rejected("bad-value", "the time is not ISO 8601") from None
    else:
        t = value / 1000
    if not (math.isfinite(t) and codec.T_MIN <= t < codec.T_MAX):
        raise Rejected("bad-value", "the time is not between 1970 and 3000")
    return round(t, 6)


def split_topic(line: bytes) -> tuple[list[str], bytes]:
    """Return the levels of the topic in front of a message, and the message.

    The topic is what precedes the first blank and brace or angle bracket; it has no level if there
    is none.
    """
    if line[:1] in (b"{", b"<"):
        return [], line
    starts = [found for found in (line.find(b" {"), line.find(b" <")) if found >= 0]
    if not starts:
        raise Rejected("malformed", "is neither a message nor a topic and a message")
    topic = line[: min(starts)].decode("utf-8", "replace")
    return topic.strip().split("/"), line[min(starts) + 1 :]
