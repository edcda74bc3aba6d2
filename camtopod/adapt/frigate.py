"""Frigate's ``frigate/events`` -> events: one message for each change of a tracked object.

Only what is named in `_Seen` is read: labels of recognised faces, plates and the like are never in
memory.

An object is told of as ``new`` when Frigate is sure of it; ``before`` then holds its first
sighting. Objects that stand where they are found again and again (a parked car) have not come in,
and one that is lost while it stands has not left. What was there before we listened has not come in
either.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated

from msgspec import Meta, Struct

from camtopod import codec
from camtopod.adapt.adapter import ANY_CAMERA, Sizes, checked, payload, size_of
from camtopod.codec import Rejected
from camtopod.records import CameraId, Event, Kind

ENTRY_SECONDS_MAX = 5.0
"""Who began to move later than this after the first sighting stood there before."""
OBJECTS_MAX = 10_000
"""Objects remembered, those of which was heard last: what is told twice counts once."""

Box = tuple[float, float, float, float]
"""Left, top, right, bottom, pixels of the picture that Frigate detects in."""
Point = tuple[tuple[float, float], float]
"""Foot point in fractions of the picture, and its time."""


class _Seen(Struct, frozen=True):
    """State of an object. ``frame_time``: when it was seen last. ``stationary``: it has not moved
    for ten seconds; ``position_changes``: how often it began to move.
    """

    id: Annotated[str, Meta(min_length=1, max_length=codec.TRACK_CHARACTERS_MAX)]
    camera: CameraId
    frame_time: float
    box: Box
    label: str = ""
    false_positive: bool = False
    stationary: bool = False
    position_changes: int | None = None
    path_data: list[Point] | None = None


class _Message(Struct, frozen=True):
    type: str
    before: _Seen
    after: _Seen


class _Object(Struct):
    """What is known of an object: its ``entry`` as long as it is not sure to be one."""

    entry: Event | None
    ended: bool = False


class Frigate:
    """Reads messages of ``frigate/events``, one JSON object a line, with the topic in front or
    without.

    ``sizes``: of the pictures that Frigate detects in (``detect: width, height``); a Frigate that
    sends ``path_data`` can do without, less exactly. ``labels``: the kinds of objects that count;
    empty: all.
    """

    topic = "events"

    def __init__(self, sizes: Sizes, labels: Collection[str] = ()) -> None:
        self._sizes, self._labels = sizes, frozenset(labels)
        self._objects: dict[str, _Object] = {}  # the one heard last is last

    def receive(self, line: bytes) -> list[Event]:
        """The entry or the exit (or both) that a message makes sure. Raises `Rejected`."""
        message = codec.read(_Message, payload(line, self.topic))
        if message.type not in ("new", "update", "end"):
            raise Rejected("bad-value", "type is not new, update or end - at `$.type`")
        now = message.after
        if not all(codec.T_MIN <= seen.frame_time < codec.T_MAX for seen in (message.before, now)):
            raise Rejected("bad-value", "frame_time is not between 1970 and 3000")
        if now.false_positive or (self._labels and now.label not in self._labels):
            return []
        known = self._objects.get(now.id) or self._met(message)
        events = self._changed(known, message)
        self._objects.pop(now.id, None)
        self._objects[now.id] = known
        while len(self._objects) > OBJECTS_MAX:
            del self._objects[next(iter(self._objects))]
        return events

    def close(self) -> list[Event]:
        """Nothing: who has not ended is still in view."""
        return []

    def _met(self, message: _Message) -> _Object:
        """An object of which nothing was heard before; it comes in if it is new."""
        if message.type != "new":
            return _Object(None)
        first, now = message.before, message.after
        if first.id == now.id and first.false_positive and self._knows_size(now.camera):
            entry = self._event("entry", first)
        elif now.path_data:
            entry = _at_point("entry", now, now.path_data[0])
        else:
            entry = self._event("entry", now)
        return _Object(entry)

    def _changed(self, known: _Object, message: _Message) -> list[Event]:
        if known.ended:
            return []
        now = message.after
        moved = now.position_changes is None or now.position_changes > 0
        events = []
        if (
            known.entry is not None
            and now.frame_time - known.entry.t > ENTRY_SECONDS_MAX
            and message.type != "new"
        ):
            known.entry = None
        if known.entry is not None and moved and not now.stationary:
            events.append(known.entry)
            known.entry = None
        if message.type == "end":
            if moved and not now.stationary:
                events.append(self._event("exit", now))
            known.ended = True
        return checked(events)

    def _knows_size(self, camera: str) -> bool:
        return camera in self._sizes or ANY_CAMERA in self._sizes

    def _event(self, kind: Kind, seen: _Seen) -> Event:
        """At the foot of the box, or without the picture's size at the end of the path. Raises
        `Rejected`.
        """
        if seen.path_data and not self._knows_size(seen.camera):
            return _at_point(kind, seen, (seen.path_data[-1][0], seen.frame_time))
        width, height = size_of(seen.camera, self._sizes)
        left, _, right, bottom = seen.box
        return _at_point(
            kind, seen, (((left + right) / 2 / width, bottom / height), seen.frame_time)
        )


def _at_point(kind: Kind, seen: _Seen, point: Point) -> Event:
    (x, y), t = point
    x, y = round(min(max(x, 0.0), 1.0), 4), round(min(max(y, 0.0), 1.0), 4)
    return Event(seen.camera, kind, round(t, 6), x, y, seen.id)
