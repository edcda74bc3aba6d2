"""Events from Frigate's ``frigate/events``: one message for each change of a tracked object.

Checked against `TrackedObject.to_dict` in Frigate's source as of 0.17.2, which has all fields of
`_Seen`, and against the page "MQTT" of its documentation.

Only the fields of `_Seen` are read: ``sub_label``, recognised faces, licence plates and the like
never enter memory.

Frigate announces an object as ``new`` once it is sure of it; ``before`` then holds the first
sighting. Objects that are repeatedly found standing (a parked car) have not entered, and an object
that is lost while it stands has not left. Objects that were present before the first message have
not entered either.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated

from msgspec import Meta, Struct
from msgspec.structs import replace

from camtopod import codec
from camtopod.adapt import adapter
from camtopod.adapt.adapter import Adapter, Sizes, remember, size_of, split_topic
from camtopod.adapt.boxes import in_picture, is_box
from camtopod.adapt.kinds import Votes, counts, is_wanted, plain, vote
from camtopod.codec import Rejected
from camtopod.labels import LABELS_MAX, count_label, most_frequent
from camtopod.records import Event, Kind

ENTRY_SECONDS_MAX = 5.0
"""Time after the first sighting within which an object must move for its entry to count.

An object that begins to move later was standing there before.
"""

Box = tuple[float, float, float, float]
"""Left, top, right, bottom, in messages pixels of the picture that Frigate detects in."""
Point = tuple[tuple[float, float], float]
"""Foot point (fractions of the picture) and its time."""


class _Seen(Struct, frozen=True):
    """State of an object in a message."""

    id: Annotated[str, Meta(min_length=1, max_length=codec.TRACK_CHARACTERS_MAX)]
    camera: str
    frame_time: float
    """Time of the latest sighting."""
    box: Box
    label: str = ""
    false_positive: bool = False
    stationary: bool = False
    """It has not moved for ten seconds."""
    position_changes: int | None = None
    """How often it began to move."""
    path_data: list[Point] | None = None
    """Path of its foot point so far."""


class _FrigateMessage(Struct, frozen=True):
    type: str
    before: _Seen
    after: _Seen


class _FrigateObject(Struct):
    """State of an object: its ``entry`` until that is told, and whether it has ended."""

    entry: Event | None
    labels: dict[str, int]
    """Messages by label."""
    votes: Votes = None
    counted: bool = False
    """Most messages had a wanted kind; from then on it goes on counting."""
    came: bool = False
    """It moved soon enough after the entry."""
    ended: bool = False


class Frigate(Adapter):
    """Adapter for ``frigate/events``: one JSON object a line, with or without the topic in front.

    sizes: sizes of the pictures that Frigate detects in (``detect: width, height``). Not needed if
        Frigate sends ``path_data``, which is less exact.
    labels: kinds of objects that count, whatever their case; empty for all.
    """

    topic = "events"

    def __init__(self, sizes: Sizes, labels: Collection[str] = ()) -> None:
        super().__init__()
        self._sizes = sizes
        self._labels = frozenset(map(plain, labels))
        self._object_count = 0
        self._unwanted: dict[str, int] = {}
        self._objects: dict[tuple[str, str], _FrigateObject] = {}  # in order of the latest message

    def receive(self, line: bytes) -> list[Event]:
        """Return the entry or exit (or both) that a message makes certain. Raises `Rejected`."""
        levels, text = split_topic(line, "*/events")
        if b'"before"' not in text:  # as what /api/events returns
            raise Rejected("bad-value", "is no message of frigate/events, with type, before, after")
        message = codec.read(_FrigateMessage, text)
        if message.type not in ("new", "update", "end"):
            raise Rejected("bad-value", "type is not new, update or end - at `$.type`")

        camera = self.cameras.id_of(message.after.camera, origin="/".join(levels[:-1]))
        now = replace(message.after, camera=camera)
        message = replace(message, before=replace(message.before, camera=camera), after=now)
        if not all(
            codec.T_MIN <= sighting.frame_time < codec.T_MAX for sighting in (message.before, now)
        ):
            raise Rejected("bad-value", "frame_time is not between 1970 and 3000")
        if now.false_positive:
            return []

        key = camera, now.id
        track = self._objects.get(key) or self._met(message)
        remember(self._objects, key, track)
        track.votes = vote(track.votes, now.label, self._labels)
        if is_wanted(now.label, self._labels):
            count_label(track.labels, now.label)
        return self._changed(track, message)

    def close(self) -> list[Event]:
        """Note it if no object counts."""
        self._check_kinds(self._object_count, self._unwanted, is_end=True)
        return []

    def _met(self, message: _FrigateMessage) -> _FrigateObject:
        """Return the state of an object at its first message; it enters if it is new."""
        if message.type != "new":
            return _FrigateObject(None, {})
        first = message.before
        now = message.after
        if first.id == now.id and first.false_positive and self._knows_size(now.camera):
            entry = self._event("entry", first)
        elif now.path_data:
            entry = _at_point("entry", now, now.path_data[0])
        else:
            entry = self._event("entry", now)
        return _FrigateObject(entry, {})

    def _changed(self, track: _FrigateObject, message: _FrigateMessage) -> list[Event]:
        """Return the events that a message makes certain, and update the object."""
        if track.ended:
            return []
        now = message.after
        has_moved = now.position_changes is None or now.position_changes > 0
        moves = has_moved and not now.stationary

        # An entry is certain once the object has moved soon enough after it.
        if track.entry is not None and not track.came:
            if message.type != "new" and now.frame_time - track.entry.t > ENTRY_SECONDS_MAX:
                track.entry = None
            track.came = moves

        # It is told once the object counts; its exit, too, unless it was standing.
        events = []
        track.ended = message.type == "end"
        if not track.counted and counts(track.votes, self._labels):
            track.counted = True
            self._object_count += 1
        if track.ended and not track.counted and len(self._unwanted) <= LABELS_MAX:
            self._unwanted[now.label] = self._unwanted.get(now.label, 0) + 1
            self._check_kinds(self._object_count, self._unwanted)
        if track.counted and track.came and track.entry is not None:
            events.append(replace(track.entry, label=most_frequent(track.labels)))
            track.entry = None
        if track.counted and track.ended and moves:
            exit_ = self._event("exit", now)
            events.append(replace(exit_, label=most_frequent(track.labels)))
        return events

    def _knows_size(self, camera: str) -> bool:
        return camera in self._sizes or adapter.ANY_CAMERA in self._sizes

    def _event(self, kind: Kind, sighting: _Seen) -> Event:
        """Return an event at the foot of the box, or at the end of the path if the size is unknown.

        Raises `Rejected`.
        """
        if sighting.path_data and not self._knows_size(sighting.camera):
            return _at_point(kind, sighting, (sighting.path_data[-1][0], sighting.frame_time))
        width, height = size_of(sighting.camera, self._sizes)
        left, top, right, bottom = sighting.box
        if not is_box(sighting.box, (width, height)):
            raise Rejected("no-area", "the box has no area")
        box = (left / width, top / height, right / width, bottom / height)
        return _in_box(kind, sighting, box, sighting.frame_time)


def _at_point(kind: Kind, sighting: _Seen, point: Point) -> Event:
    (x, y), t = point
    return _in_box(kind, sighting, (x, y, x, y), t)


def _in_box(kind: Kind, sighting: _Seen, box: Box, t: float) -> Event:
    """Return an event at the foot of a box, in fractions of the picture; raise `Rejected`."""
    foot = in_picture(box, adapter.OUTSIDE_MAX)
    if foot is None:
        raise Rejected("outside", "the object lies outside the picture: is --size right?")
    return Event(sighting.camera, kind, round(t, 6), *foot, sighting.id)
