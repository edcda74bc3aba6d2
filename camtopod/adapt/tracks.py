"""Any tracker's output -> events: an entry where a track begins, an exit where it ends."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec import Struct

from camtopod.codec import TRACK_CHARACTERS_MAX
from camtopod.records import CAMERA_PATTERN, Event, Kind

LIFE_SECONDS = 0.5
"""A track that did not live for this long was none."""
LOST_SECONDS = 2.0
"""A track that was not seen for longer than this has ended. With the first it has to stay below the
lateness (`learn.lateness_seconds`, 5 s): events are reported by so much after their time.
"""
START_SECONDS = 1.0
"""Who begins within this of the first frame was there before: trackers need a moment to be sure of
anybody.
"""
BOOT_CHARACTERS_MAX = 64
"""As in `camtopod.records.Event`."""
TRACKS_MAX = 1000
"""Tracks followed at a time; further ones are counted, until others have ended."""


class _Place(Struct, frozen=True):
    """Where a track was when; fractions of the picture."""

    t: float
    x: float
    y: float


class _Track(Struct):
    first: _Place
    last: _Place
    from_start: bool
    lived: bool = False


class TrackEvents:
    """Turns what a tracker says about the frames of one camera into entry and exit events.

    `update` takes each frame's tracks, in the order of time; frames without any may be left out,
    but for the first. A track's entry is at its first position, reported once it has lived for
    ``life_seconds``; its exit is at its last one, reported when it has not been seen for more than
    ``lost_seconds``, both by the time that is given, so the same frames give the same events. Who
    is in view at the start (`START_SECONDS`) was there before: no entry.

    ``camera``: its id, ``[A-Za-z0-9_.-]{1,64}``. ``size``: width and height of the picture that the
    boxes are of, in pixels; (1, 1) for boxes that are fractions. ``boot``: a name for this run that
    no other run of this camera had; with it the events are numbered (``seq`` from 0), and one that
    is delivered twice counts once. At most ``tracks_max`` tracks are followed at a time. Raises
    `ValueError` where one of these makes no sense.

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
    ) -> None:
        if not re.match(CAMERA_PATTERN, camera):
            raise ValueError(f"camera {camera!r}: 1 to 64 of the characters A-Z a-z 0-9 _ . -")
        if boot is not None and not 0 < len(boot) <= BOOT_CHARACTERS_MAX:
            raise ValueError(f"boot {boot!r}: 1 to {BOOT_CHARACTERS_MAX} characters")
        if len(size) != 2 or not all(0 < side < math.inf for side in size):
            raise ValueError(f"size {size!r}: width and height of the picture, in pixels")
        if not (0 <= life_seconds < math.inf and 0 < lost_seconds < math.inf):
            raise ValueError("life_seconds and lost_seconds are above 0")
        self.camera, self.size = camera, (float(size[0]), float(size[1]))
        self._boot, self._seq = boot, 0
        self._life, self._lost, self._max = life_seconds, lost_seconds, tracks_max
        self._tracks: dict[str, _Track] = {}  # the one seen last is last
        self._start = self._t = -math.inf
        self.entries = 0
        self.exits = 0
        self.untracked = 0
        """Boxes without an id: None or negative, as trackers mark what they do not follow (yet)."""
        self.unusable = 0
        """Boxes that are not four finite numbers."""
        self.refused = 0
        """Boxes of tracks beyond ``tracks_max``."""
        self.late = 0
        """Frames left out because a later one came before them."""

    def update(
        self, ids: Sequence[Any] | Any | None, boxes: Sequence[Any] | Any, t: float
    ) -> list[Event]:
        """One frame's tracks; returns the events that are sure now.

        ``ids``: n numbers or strings; None where a box has no track, or for all (supervision's
        ``tracker_id`` while nothing is tracked). ``boxes``: n times left, top, right, bottom in
        pixels, shape (n, 4) or (n, 2, 2); a list or an array. ``t``: the frame's time of capture,
        seconds. A frame up to ``lost_seconds`` earlier than one before is counted (``late``) and
        left out; one further back means that the clock was set: everything begins anew. Raises
        `ValueError` if ids and boxes do not match or ``t`` is no time.
        """
        labels = _labels(ids)
        corners = np.asarray(boxes, dtype=float)
        if ids is None:
            labels = [None] * (corners.size // 4)
        if corners.size != 4 * len(labels) or (labels and len(corners) != len(labels)):
            raise ValueError(
                f"{len(labels)} ids, but boxes of shape {corners.shape}: n ids need boxes (n, 4)"
            )
        t = round(float(t), 6)
        if not math.isfinite(t):
            raise ValueError("t is not a finite number of seconds")
        if self.is_late(t):
            self.late += 1
            return []
        if t < self._t:
            self._begin_anew()
        if self._t == -math.inf:
            self._start = t
        self._t = t
        events = self._ended(t)
        for label, corner in zip(labels, corners.reshape(-1, 4).tolist(), strict=True):
            events += self._seen(label, corner, t)
        return events

    def is_late(self, t: float) -> bool:
        """Whether `update` would leave a frame of this time out, as a later one has come."""
        return 0 < self._t - t <= self._lost

    def close(self) -> list[Event]:
        """The recording ends: tracks out of sight in its last frame have left, the others are still
        in view.
        """
        left = [
            label
            for label, track in self._tracks.items()
            if track.lived and track.last.t != self._t
        ]
        events = [self._event("exit", label, self._tracks[label].last) for label in left]
        self._begin_anew()
        return events

    def statistics(self) -> dict[str, int]:
        """Counters, and how many tracks are followed."""
        return {
            "tracks": len(self._tracks),
            "entries": self.entries,
            "exits": self.exits,
            "untracked": self.untracked,
            "unusable": self.unusable,
            "refused": self.refused,
            "late": self.late,
        }

    def _begin_anew(self) -> None:
        self._tracks, self._t = {}, -math.inf

    def _ended(self, t: float) -> list[Event]:
        events = []
        while self._tracks:
            label, track = next(iter(self._tracks.items()))
            if t - track.last.t <= self._lost:
                break
            del self._tracks[label]
            if track.lived:
                events.append(self._event("exit", label, track.last))
        return events

    def _seen(self, label: str | None, corners: list[float], t: float) -> list[Event]:
        if label is None:
            self.untracked += 1
            return []
        if not all(map(math.isfinite, corners)):
            self.unusable += 1
            return []
        place = self._foot(corners, t)
        track = self._tracks.pop(label, None)
        if track is None:
            if len(self._tracks) >= self._max:
                self.refused += 1
                return []
            track = _Track(place, place, from_start=t - self._start <= START_SECONDS)
        track.last = place
        self._tracks[label] = track
        if track.lived or t - track.first.t < self._life:
            return []
        track.lived = True
        return [] if track.from_start else [self._event("entry", label, track.first)]

    def _foot(self, corners: list[float], t: float) -> _Place:
        """Bottom centre of the box, within the picture."""
        left, _, right, bottom = corners
        x, y = (left + right) / 2 / self.size[0], bottom / self.size[1]
        return _Place(t, round(min(max(x, 0.0), 1.0), 4), round(min(max(y, 0.0), 1.0), 4))

    def _event(self, kind: Kind, label: str, at: _Place) -> Event:
        if kind == "entry":
            self.entries += 1
        else:
            self.exits += 1
        seq = None
        if self._boot is not None:
            seq = self._seq
            self._seq += 1
        return Event(self.camera, kind, at.t, at.x, at.y, label, self._boot, seq)


def _labels(ids: Any) -> list[str | None]:
    """The ids as events name them; None for what is not tracked."""
    if ids is None:
        return []
    values = ids.tolist() if hasattr(ids, "tolist") else ids
    return [_label(value) for value in values]


def _label(value: Any) -> str | None:
    if isinstance(value, int | float | np.number):  # some trackers keep ids in an array of floats
        value = int(value) if 0 <= value < math.inf else None
    return None if value is None else str(value)[:TRACK_CHARACTERS_MAX]
