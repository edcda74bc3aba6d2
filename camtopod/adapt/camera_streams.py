"""Tracks of several cameras in one stream: camera, time and boxes of each message.

Shared by `axis`, `onvif`, `deepstream` and `scenescape`, whose messages are frames with boxes.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Sequence
from typing import NamedTuple

from camtopod import codec
from camtopod.adapt.adapter import OUTSIDE_MAX, Adapter, Size
from camtopod.adapt.box_linking import BoxLinker
from camtopod.adapt.camera_names import CAMERAS_MAX
from camtopod.adapt.tracks import TRACKS_MAX, TrackEvents
from camtopod.codec import Rejected
from camtopod.event_time import seconds_of_text
from camtopod.records import Event

AHEAD_SECONDS = 60.0
"""Seconds by which a frame is so far ahead of the last that the next one has to confirm it."""
CHECK_FRAMES = 25
"""Frames after which boxes and kinds are checked again."""
SILENT_SECONDS = 2.5
"""Time without a frame after which a camera's objects have left.

Many cameras send nothing while the view is empty. An exit that waited for the next frame would be
late. Of those that do send then, frames are late.
"""

Box = tuple[float, float, float, float]
"""Left, top, right, bottom."""
Name = str | int | None
"""Id of a track; None for a box that the tracker does not follow."""


class TrackedBox(NamedTuple):
    """A box of a frame, in units of the stream's ``size``."""

    name: Name
    box: Box
    kind: str
    """Kind of the object; empty if it is unknown."""


class CameraStream:
    """Tracks of one camera, or of one analytics module of a camera."""

    def __init__(self, camera: str, size: Size, labels: Collection[str]) -> None:
        self.tracks = TrackEvents(camera, size, outside_max=OUTSIDE_MAX, wanted_labels=labels)
        self.arrival = 0.0
        """When the latest frame came, seconds of the clock of `StreamAdapter.silent`."""
        self.linker: BoxLinker | None = None
        """Names the boxes; None if they have the names of a tracker."""
        self._t = -math.inf
        self._frame_ahead: tuple[Sequence[TrackedBox], Sequence[Name], float] | None = None
        """A frame that is far ahead: it may have a wrong time."""
        self._empty = False
        self._keeps_sending = False
        """While the view is empty."""

    def update(
        self, tracked_boxes: Sequence[TrackedBox], ended_names: Sequence[Name], t: float
    ) -> list[Event]:
        """Return the events that a frame at ``t`` (seconds) makes certain.

        ended_names: tracks that the tracker reports as ended.

        A frame that is far ahead waits for the next one, and is dropped if that is before it.
        Raises `Rejected` if a later frame came before, the frame has too many boxes, or the boxes
        of this camera are misread.
        """
        self.require_newer(t)
        if len(tracked_boxes) > TRACKS_MAX:
            raise Rejected("too-many", f"more than {TRACKS_MAX} objects in a frame")
        events = []
        if self._frame_ahead is not None and t >= self._frame_ahead[2]:
            events = self._take(*self._frame_ahead)
        elif self._frame_ahead is None and t - self._t > AHEAD_SECONDS and self._t > -math.inf:
            self._frame_ahead = tracked_boxes, ended_names, t
            return []
        self._frame_ahead = None
        events += self._take(tracked_boxes, ended_names, t)
        if self.tracks.is_misread:
            raise Rejected(
                "other-boxes",
                f"boxes of {self.tracks.camera} are sizes for corners, or corners for sizes: none "
                "is used",
            )
        return events

    def _take(
        self, tracked_boxes: Sequence[TrackedBox], ended_names: Sequence[Name], t: float
    ) -> list[Event]:
        if self._empty and t - self._t > SILENT_SECONDS:
            self._keeps_sending = False
        elif self._empty and not tracked_boxes and t > self._t:
            self._keeps_sending = True
        self._empty = not tracked_boxes
        self._t = t
        names, boxes, kinds = zip(*tracked_boxes, strict=True) if tracked_boxes else ((), (), ())
        if self.linker is not None:
            names = tuple(self.linker.link(kinds, boxes, t))
        events = self.tracks.update(names, boxes, t, kinds)
        for name in ended_names:
            events += self.tracks.end(name)
        return events

    def close(self) -> list[Event]:
        """Return the events of the end of the input (`TrackEvents.close`)."""
        events = [] if self._frame_ahead is None else self._take(*self._frame_ahead)
        return events + self.tracks.close()

    def lose(self) -> list[Event]:
        """Return the exits of all objects, as no frame has come for too long.

        Of a camera that keeps sending while its view is empty the frames are late (the broker or
        the network stalls), so no object has left.
        """
        if self._keeps_sending and not self._empty:
            return []
        return self.tracks.lose()

    def require_newer(self, t: float) -> None:
        """Raise `Rejected` if a frame at ``t`` comes after a later one."""
        if self.tracks.is_late(t):
            raise Rejected("out-of-order", "a later frame of this camera came before")


class StreamAdapter(Adapter):
    """Base of adapters whose messages are frames of several cameras.

    camera: id of the one camera; None if the messages or their topics name the cameras.
    labels: kinds of objects that count, whatever their case; empty for all.
    """

    def __init__(self, camera: str | None = None, labels: Collection[str] = ()) -> None:
        super().__init__(camera)
        self._labels = labels
        self._streams: dict[tuple[str, str], CameraStream] = {}
        self._frames = 0
        self._last_call = self._now = self._last_check = 0.0

    def silent(self, now: float) -> list[Event]:
        """Return the exits of the objects of cameras that have sent no frame for `SILENT_SECONDS`.

        now: as for `Adapter.silent`.
        """
        # Time in which this program stood still does not count: frames may wait to be read.
        elapsed = now - self._last_call
        self._last_call = now
        if elapsed <= SILENT_SECONDS:
            self._now += elapsed
        if self._now - self._last_check < SILENT_SECONDS / 5:
            return []
        self._last_check = self._now
        silent = (s for s in self._streams.values() if self._now - s.arrival > SILENT_SECONDS)
        return [event for stream in silent for event in stream.lose()]

    def close(self) -> list[Event]:
        """Return the exits of objects out of sight. Those in a camera's last frame are in view."""
        events = [event for stream in self._streams.values() for event in stream.close()]
        for stream in self._streams.values():
            self._check_boxes(stream.tracks.camera, stream.tracks.statistics(), is_end=True)
        self._check_all_kinds(is_end=True)
        return events

    def _stream(self, camera: str, size: Size = (1, 1), module: str = "") -> CameraStream:
        """Return the stream of a camera's analytics module, new or known. Raises `Rejected`.

        size: width and height of the picture, pixels; (1, 1) if boxes are fractions of it.
        """
        stream = self._streams.get((camera, module))
        if stream is None:
            if len(self._streams) >= CAMERAS_MAX:
                raise Rejected("too-many-cameras", f"more than {CAMERAS_MAX} cameras")
            stream = CameraStream(camera, size, self._labels)
            self._streams[camera, module] = stream
        self._frames += 1
        if self._frames % CHECK_FRAMES == 0:
            self._check_boxes(camera, stream.tracks.statistics())
            self._check_all_kinds()
        stream.arrival = self._now
        if stream.tracks.is_misread:
            raise Rejected(
                "other-boxes", f"boxes of {camera} are not {self.box_form}: none is used"
            )
        return stream

    def _check_all_kinds(self, is_end: bool = False) -> None:
        """Note it once if no object of any camera counts."""
        unwanted = Counter[str]()
        for stream in self._streams.values():
            unwanted.update(stream.tracks.unwanted)
        object_count = sum(stream.tracks.object_count for stream in self._streams.values())
        self._check_kinds(object_count, unwanted, is_end)


def seconds_of(value: str | float) -> float:
    """Return the seconds since the epoch of a time; raise `Rejected` if it is none.

    value: ISO 8601 (UTC if it names no zone), or seconds or milliseconds since the epoch.
    """
    try:
        if isinstance(value, str):
            t = seconds_of_text(value)
        else:
            t = value if abs(value) < codec.RECORD_T_MAX else value / 1000
    except (ValueError, OverflowError):
        raise Rejected("bad-value", "the time is not ISO 8601") from None
    if not (math.isfinite(t) and codec.T_MIN <= t < codec.T_MAX):
        raise Rejected("bad-value", "the time is not between 1970 and 3000")
    return round(t, 6)
