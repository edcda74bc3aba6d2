"""Link boxes without identity into tracks, by nearest predicted position."""

from __future__ import annotations

import math
from collections.abc import Sequence

from msgspec import Struct

from camtopod.adapt.tracks import LIFE_SECONDS, LOST_SECONDS, TRACKS_MAX

REACH = 0.75
"""Largest distance of a box from a predicted middle, in larger sides of the smaller box."""
ALIKE = 0.5
"""Least ratio of two boxes' larger sides if their kinds differ: no plate continues a car."""

Box = tuple[float, float, float, float]
"""Left, top, right, bottom, pixels."""
Point = tuple[float, float]


class _BoxTrack(Struct):
    kind: str
    box: Box
    t: float
    velocity: Point = (0.0, 0.0)
    """Velocity of the box's middle, pixels per second."""

    def at(self, t: float) -> Point:
        """Return the predicted middle of the box at ``t``: it moves on for `LIFE_SECONDS`."""
        x, y = _middle(self.box)
        ahead = min(max(t - self.t, 0.0), LIFE_SECONDS)
        return x + ahead * self.velocity[0], y + ahead * self.velocity[1]

    def move(self, kind: str, box: Box, t: float) -> None:
        """Record that the track was seen there."""
        if t > self.t:
            # Half of the old velocity, and half of the newest step.
            steps = zip(_middle(self.box), _middle(box), self.velocity, strict=True)
            x, y = (((new - old) / (t - self.t) + v) / 2 for old, new, v in steps)
            self.velocity = (x, y)
        self.kind = kind
        self.box = box
        self.t = t


class BoxLinker:
    """Links the boxes in one camera into tracks, numbered from 1. Deterministic.

    The nearest pair of box and track of one kind is linked first; a box that is left continues a
    track of another kind, as detectors change their mind. Two people who meet and turn back may
    exchange numbers: entries and exits stay the same, only their pairing into passages does not. At
    most `TRACKS_MAX` tracks are kept; tracks not seen for `LOST_SECONDS` are forgotten.
    """

    def __init__(self) -> None:
        self._tracks: dict[int, _BoxTrack] = {}
        self._count = 0

    def link(self, kinds: Sequence[str], boxes: Sequence[Box], t: float) -> list[int | None]:
        """Return the track number of each box of the frame at ``t``; None beyond the limit."""
        self._tracks = {
            n: track for n, track in self._tracks.items() if abs(t - track.t) <= LOST_SECONDS
        }
        number_of_box: dict[int, int] = {}
        taken_numbers: set[int] = set()
        for _, _, number, index in sorted(self._pairs(kinds, boxes, t)):
            if number not in taken_numbers and index not in number_of_box:
                number_of_box[index] = number
                taken_numbers.add(number)
                self._tracks[number].move(kinds[index], boxes[index], t)
        return [
            number_of_box.get(index) or self._begin(kinds[index], box, t)
            for index, box in enumerate(boxes)
        ]

    def _begin(self, kind: str, box: Box, t: float) -> int | None:
        """Begin a track and return its number; None if there are too many."""
        if len(self._tracks) >= TRACKS_MAX:
            return None
        self._count += 1
        self._tracks[self._count] = _BoxTrack(kind, box, t)
        return self._count

    def _pairs(
        self, kinds: Sequence[str], boxes: Sequence[Box], t: float
    ) -> list[tuple[bool, float, int, int]]:
        """Return (kinds differ, distance, track, box's index) of pairs that may be one object."""
        pairs = []
        for number, track in self._tracks.items():
            place = track.at(t)
            for index, box in enumerate(boxes):
                distance = math.dist(place, _middle(box))
                smaller, larger = sorted((_larger_side(track.box), _larger_side(box)))
                differ = kinds[index] != track.kind
                if distance <= REACH * smaller and (not differ or smaller >= ALIKE * larger):
                    pairs.append((differ, distance, number, index))
        return pairs


def _middle(box: Box) -> Point:
    return (box[0] + box[2]) / 2, (box[1] + box[3]) / 2


def _larger_side(box: Box) -> float:
    return max(box[2] - box[0], box[3] - box[1])
