"""Events from any tracker's output: an entry where a track begins, an exit where it ends."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from msgspec import Struct

from camtopod import codec
from camtopod.adapt.adapter import BEYOND_SHARE, OUTSIDE_BOXES, remember
from camtopod.adapt.boxes import in_picture, is_box
from camtopod.adapt.kinds import Votes, counts, is_wanted, plain, vote
from camtopod.labels import LABEL_CHARACTERS_MAX, LABELS_MAX, count_label, most_frequent
from camtopod.records import Event, Kind

LIFE_SECONDS = 0.5
"""Shortest track that counts as an object, seconds."""
LOST_SECONDS = 2.0
"""Time without a sighting after which a track has ended.

It delays exits, as `LIFE_SECONDS` delays entries, and must stay below the lateness
(`learn.lateness_seconds`, 5 s).
"""
UNCLASSIFIED_SECONDS = 4.0
"""Longest time that an entry waits for the kind of its object; as long as the lateness allows."""
IDLE_SECONDS_MAX = 3600.0
"""Longest time that an object that stands still need not be seen, seconds (`TrackEvents.hold`)."""
BACK_FRAMES_MIN = 5
"""Frames in a row, each later than the last, after which the clock was set back.

They are of more than ``lost_seconds``, too; fewer are old frames that come late or again.
"""
TRACKS_MAX = 1000
"""Tracks followed at a time; boxes of further ones are counted as refused."""


class _Place(Struct, frozen=True):
    """A track's position (fractions of the picture) at a time."""

    t: float
    x: float
    y: float


class _Track(Struct):
    """Beginning and latest position of a track; ``counted`` once it has had its entry."""

    first: _Place
    last: _Place
    from_start: bool
    votes: Votes
    labels: dict[str, int]
    """Sightings by label."""
    counted: bool = False
    kind: str = ""
    """The last kind that it was said to be."""
    left: bool = False
    """Its exit was told while no frames came."""


class TrackEvents:
    """Converts the tracks of one camera, frame by frame, into entry and exit events.

    Pass each frame's tracks to `update`, in order of time. Frames without tracks may be omitted,
    except the first. A track's entry is at its first position and is returned once the track has
    lived for ``life_seconds``; its exit is at its last position and is returned once it has not
    been seen for more than ``lost_seconds``. Only the given times count, so the same frames give
    the same events. Objects in view at the start (within two `LIFE_SECONDS`, as
    trackers need a moment) have no entry.

    With ``kinds`` the majority of a track's sightings decides whether it counts, and once it has
    counted it goes on counting. Its entry waits for a kind, up to `UNCLASSIFIED_SECONDS` if all
    count. So pass the boxes of all kinds, and let ``wanted_labels`` choose. The most frequent of
    the kinds that count is the ``label`` of an event.

    camera: id of the camera, ``[A-Za-z0-9_.-]{1,64}``.
    size (pixels): width and height of the picture; (1, 1) if boxes are fractions of it.
    boot: a name of this run, unique among the camera's runs. With it events are numbered (``seq``
        from 0), so that one that is delivered twice counts once.
    life_seconds: shortest track that counts as an object.
    lost_seconds: time without a sighting after which a track has ended.
    tracks_max: tracks followed at a time.
    outside_max: boxes that are as a whole further outside the picture than this fraction of it are
        not used. Foot points are clipped to the picture.
    wanted_labels: kinds that count; empty for all but faces, heads and plates (`kinds.PARTS`).

    Raises `ValueError` for an invalid argument.

    >>> tracks = TrackEvents("lobby", (640, 480), boot="monday")
    >>> tracks.update([], [], 0.0)  # nobody there, at 0 s
    []
    >>> for t in (2.0, 2.5, 3.0):  # box: left, top, right, bottom
    ...     events = tracks.update([7], [[100, 90, 140, 96 * t]], t)
    ...     print([(e.kind, e.t, e.x, e.y, e.track, e.seq) for e in events])
    []
    [('entry', 2.0, 0.1875, 0.4, '7', 0)]
    []
    >>> [(e.kind, e.t, e.x, e.y, e.track, e.seq) for e in tracks.update([], [], 5.1)]
    [('exit', 3.0, 0.1875, 0.6, '7', 1)]
    """

    def __init__(
        self,
        camera: str,
        size: tuple[float, float],
        *,
        boot: str | None = None,
        life_seconds: float = LIFE_SECONDS,
        lost_seconds: float = LOST_SECONDS,
        tracks_max: int = TRACKS_MAX,
        outside_max: float = math.inf,
        wanted_labels: Collection[str] = (),
    ) -> None:
        codec.require_camera(camera)
        if boot is not None and not 0 < len(boot) <= 64:
            raise ValueError(f"boot {boot!r}: 1 to 64 characters")
        if len(size) != 2 or not all(0 < side < math.inf for side in size):
            raise ValueError(f"size {size!r}: width and height of the picture, in pixels")
        if not (0 <= life_seconds < math.inf and 0 < lost_seconds < math.inf):
            raise ValueError("life_seconds and lost_seconds are above 0")
        self.camera = camera
        self.size = (float(size[0]), float(size[1]))
        self._boot = boot
        self._seq = 0
        self._life = life_seconds
        self._lost_seconds = lost_seconds
        self._max = tracks_max
        self._outside_max = outside_max
        self._wanted_labels = frozenset(map(plain, wanted_labels))
        self._tracks: dict[str, _Track] = {}  # the one seen last is last
        self._verdicts: dict[str, tuple[Votes, dict[str, int]]] = {}
        """Kinds and labels of lost tracks, as one sighting: a program may send the kind only once.
        """
        self._kinds_come = False
        self._waited_in_vain = False
        self._start = self._t = -math.inf
        self.entries = 0
        self.exits = 0
        self.untracked_count = 0
        """Boxes without an id (None or negative), which the tracker does not follow (yet)."""
        self._idle: dict[str, _Track] = {}  # the one seen last is last
        self._expected: dict[str, None] = {}
        self._back_first = self._back_last = math.inf
        self._back_count = 0
        """Old frames in a row: time of the first and the last, and their number."""
        self.unusable = 0
        """Boxes that are not four finite numbers, have no area, or are no larger than a pixel."""
        self.outside = 0
        """Boxes beyond ``outside_max``."""
        self.beyond = 0
        """Boxes that were used, of which a part is beyond ``outside_max``."""
        self.used = 0
        """Boxes that were used."""
        self._inverted = 0
        """Boxes that end before they begin, as sizes for corners do."""
        self._doubled = self._single = 0
        """Boxes twice as far as they begin, as corners for sizes are, and beyond the right border;
        those that do not reach so far.
        """
        self.unwanted: dict[str, int] = {}
        """Objects that have ended and were none of ``wanted_labels``, by their last kind."""
        self.object_count = 0
        """Objects that count."""
        self.refused_count = 0
        """Boxes of tracks beyond ``tracks_max``."""
        self.late = 0
        """Frames ignored because a later one came before them."""

    def update(
        self,
        ids: Sequence[Any] | Any | None,
        boxes: Sequence[Any] | Any,
        t: float,
        kinds: Sequence[str] | None = None,
    ) -> list[Event]:
        """Process one frame; return the events that are now certain.

        ids (n): numbers or strings. None for a box without a track, or for all boxes (supervision's
            ``tracker_id`` while nothing is tracked).
        boxes ((n, 4) or (n, 2, 2), pixels): left, top, right, bottom; a list or an array.
        t (seconds): capture time of the frame.
        kinds (n): what the objects are (``person``), empty where it is unknown; None if that is not
            known of any object.

        A frame earlier than a previous one is ignored and counted (``late``), unless it goes on
        from others that were: if they are `BACK_FRAMES_MIN` and span ``lost_seconds``, the clock
        was set, and tracking restarts. Raises `ValueError` if ids, boxes and kinds do not match or
        ``t`` is not finite.
        """
        # Check and normalise the arguments.
        corners = np.asarray(boxes, dtype=float)
        if ids is None:
            ids = [None] * (corners.size // 4)
        labels = [_label(name) for name in np.asarray(ids, dtype=object).tolist()]
        if corners.size != 4 * len(labels) or (labels and len(corners) != len(labels)):
            raise ValueError(
                f"{len(labels)} ids, but boxes of shape {corners.shape}: n ids need boxes (n, 4)"
            )
        if kinds is not None and len(kinds) != len(labels):
            raise ValueError(f"{len(labels)} ids, but {len(kinds)} kinds")
        t = round(float(t), 6)
        if not math.isfinite(t):
            raise ValueError("t is not a finite number of seconds")

        # Frames out of order.
        if self.is_late(t):
            self.late += 1
            return []
        if t < self._t:
            self._begin_anew()
        self._back_count = 0
        if self._t == -math.inf:
            self._start = t
        self._t = t

        # Tracks that have ended, then those of this frame. They are in order of the last sighting.
        lost_tracks = itertools.takewhile(
            lambda item: t - item[1].last.t > self._lost_seconds, self._tracks.items()
        )
        expired_tracks = itertools.takewhile(
            lambda item: t - item[1].last.t > IDLE_SECONDS_MAX, self._idle.items()
        )
        events = []
        for track_id, track in [*lost_tracks, *expired_tracks]:
            if track.votes is not None:
                kind = most_frequent(track.labels)
                sightings = {} if kind is None else {kind: 1}
                remember(self._verdicts, track_id, (min(max(track.votes, -1), 1), sightings))
            events += self._exit(track_id, self._pop(track_id) or track)
        kind_names: Sequence[str | None] = [None] * len(labels) if kinds is None else kinds
        for label, corner, kind in zip(
            labels, corners.reshape(-1, 4).tolist(), kind_names, strict=True
        ):
            events += self._seen(label, corner, kind, t)
        return events

    def end(self, name: Any) -> list[Event]:
        """End the track of an id that the tracker declares ended; return its exit, if any."""
        label = _label(name)
        track = None if label is None else self._pop(label)
        return [] if label is None or track is None else self._exit(label, track)

    def hold(self, name: Any) -> None:
        """Keep the track of an id that is not seen for a while, as the object stands still.

        It goes on when it is seen again, and ends with `end` or after `IDLE_SECONDS_MAX`.
        """
        label = _label(name)
        if label is not None and label in self._tracks:
            self._idle[label] = self._tracks.pop(label)

    def expect(self, name: Any) -> None:
        """Begin the next track of an id without an entry: it was part of another one."""
        label = _label(name)
        if label is not None:
            remember(self._expected, label, None)

    def follows(self, name: Any) -> bool:
        """Return True if there is a track of an id."""
        label = _label(name)
        return label in self._tracks or label in self._idle

    def lose(self) -> list[Event]:
        """Return the exits of all tracks, as no frame has come for too long.

        A track that the next frames show within ``lost_seconds`` of their times goes on.
        """
        events = []
        for label, track in self._tracks.items():
            events += self._exit(label, track)
            track.left = True
        return events

    def is_late(self, t: float) -> bool:
        """Return True if `update` would ignore a frame of this time, which has come now."""
        if t >= self._t:
            return False
        if self._t - t <= self._lost_seconds:
            return True
        if not self._back_count or t < self._back_last:
            self._back_first, self._back_count = t, 1
        elif t > self._back_last:
            self._back_count += 1
        self._back_last = t
        span = self._back_last - self._back_first
        return self._back_count < BACK_FRAMES_MIN or span <= self._lost_seconds

    def close(self) -> list[Event]:
        """End the recording; return the exits of tracks that were out of sight in its last frame.

        The others are still in view; their entries wait no longer.
        """
        events = []
        for label, track in (*self._tracks.items(), *self._idle.items()):
            if track.last.t == self._t or label in self._idle:
                events += self._entry(label, track)
            else:
                events += self._exit(label, track)
        self._begin_anew()
        return events

    def statistics(self) -> dict[str, int]:
        """Return the counters and the number of tracks followed."""
        return {
            "tracks": len(self._tracks) + len(self._idle),
            "entries": self.entries,
            "exits": self.exits,
            "untracked": self.untracked_count,
            "unusable": self.unusable,
            "outside": self.outside,
            "beyond": self.beyond,
            "used": self.used,
            "refused": self.refused_count,
            "late": self.late,
        }

    @property
    def is_misread(self) -> bool:
        """True while the boxes cannot be left, top, right, bottom: they make no events.

        Many of them end before they begin, as sizes for corners do. Or all of them reach twice as
        far as they begin, and many beyond the right border, as corners that are taken for sizes do.
        """
        boxes = self.used + self.unusable
        many = max(OUTSIDE_BOXES, BEYOND_SHARE * boxes)
        return self._inverted >= many or (self._doubled >= many and not self._single)

    def _pop(self, label: str) -> _Track | None:
        """Remove and return a track; None if there is none."""
        return self._tracks.pop(label, None) or self._idle.pop(label, None)

    def _begin_anew(self) -> None:
        self._tracks = {}
        self._idle = {}
        self._t = -math.inf

    def _exit(self, label: str, track: _Track) -> list[Event]:
        """Return the exit of a track that counts, and its entry if that has waited for the kind."""
        if track.left or self.is_misread:
            return []
        events = self._entry(label, track)
        if track.counted:
            events.append(self._event("exit", label, track, track.last))
        elif self._wanted_labels and track.last.t - track.first.t >= self._life:
            kind = track.kind[:LABEL_CHARACTERS_MAX] if len(self.unwanted) < LABELS_MAX else ""
            self.unwanted[kind] = self.unwanted.get(kind, 0) + 1
        return events

    def _entry(self, label: str, track: _Track) -> list[Event]:
        """Return the entry of a track that counts as an object from now on."""
        has_lived = track.last.t - track.first.t >= self._life
        is_object = has_lived and counts(track.votes, self._wanted_labels)
        if track.counted or not is_object or self.is_misread:
            return []
        track.counted = True
        self.object_count += 1
        return [] if track.from_start else [self._event("entry", label, track, track.first)]

    def _seen(
        self, label: str | None, corners: list[float], kind: str | None, t: float
    ) -> list[Event]:
        """Record a box; return the entry if its track now counts as an object."""
        if label is None:
            self.untracked_count += 1
            return []
        left, top, right, bottom = corners
        if not is_box(corners, self.size):
            self.unusable += 1
            self._inverted += right < left or bottom < top
            return []
        width, height = self.size
        box = (left / width, top / height, right / width, bottom / height)
        foot = in_picture(box, self._outside_max)
        if foot is None:
            self.outside += 1
            return []
        self.used += 1
        self.beyond += max(-box[0], box[2] - 1, -box[1], box[3] - 1) > self._outside_max
        is_single = right <= 2 * left or bottom <= 2 * top
        self._single += is_single
        self._doubled += not is_single and left >= 0 and box[2] - 1 > self._outside_max

        # Begin the track or update it.
        place = _Place(t, *foot)
        track = self._pop(label)
        if track is None:
            if len(self._tracks) + len(self._idle) >= self._max:
                self.refused_count += 1
                return []
            from_start = t - self._start <= 2 * LIFE_SECONDS or label in self._expected
            self._expected.pop(label, None)
            votes, sightings = self._verdicts.pop(label, (None, {}))
            track = _Track(place, place, from_start, votes, sightings)
        track.left = track.left and t <= track.last.t  # the same frame again
        track.last = place
        track.kind = kind or track.kind
        track.votes = vote(track.votes, kind or "", self._wanted_labels)
        if is_wanted(kind or "", self._wanted_labels):
            count_label(track.labels, kind or "")
        self._tracks[label] = track

        # The entry is certain once the track has lived long enough, and its kind is known.
        self._kinds_come |= track.votes is not None
        may_come = kind is not None and (self._kinds_come or not self._waited_in_vain)
        waits = may_come and track.votes is None
        if waits and (track.from_start or t - track.first.t < UNCLASSIFIED_SECONDS):
            return []
        self._waited_in_vain |= waits
        return self._entry(label, track)

    def _event(self, kind: Kind, name: str, track: _Track, at: _Place) -> Event:
        if kind == "entry":
            self.entries += 1
        else:
            self.exits += 1
        seq = None
        if self._boot is not None:
            seq = self._seq
            self._seq += 1
        label = most_frequent(track.labels)
        return Event(self.camera, kind, at.t, at.x, at.y, name, self._boot, seq, label=label)


def _label(value: Any) -> str | None:
    """Return an id as a string; None for a box that is not tracked."""
    if isinstance(value, int | float | np.number):  # some trackers return ids as floats
        if not 0 <= value < math.inf:
            return None
        value = int(value)
    if value is None:
        return None
    return str(value)[: codec.TRACK_CHARACTERS_MAX]
