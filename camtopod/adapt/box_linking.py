"""Boxes without identity -> tracks: a box continues the track that was going to be nearest, if it
is near enough.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from msgspec import Struct

from camtopod.adapt.tracks import LOST_SECONDS, TRACKS_MAX

REACH = 0.75
"""How far the middle of a box may be from where it was going to be, in larger sides of the smaller
box.
"""
COAST_SECONDS = 0.5
"""A track not seen is taken to go on as before for this long, and then to wait."""
_NEW_SHARE = 0.5
"""Share of the newest step in a track's velocity."""

Box = tuple[float, float, float, float]
"""Left, top, right, bottom, pixels."""
Point = tuple[float, float]


class _Track(Struct):
    box: Box
    t: float
    velocity: Point = (0.0, 0.0)
    """Of the box's middle, pixels a second."""

    def at(self, t: float) -> Point:
        """Where the middle is going to be."""
        x, y = _middle(self.box)
        ahead = min(max(t - self.t, 0.0), COAST_SECONDS)
        return x + ahead * self.velocity[0], y + ahead * self.velocity[1]

    def move(self, box: Box, t: float) -> None:
        """It was seen there."""
        if t > self.t:
            steps = zip(_middle(self.box), _middle(box), self.velocity, strict=True)
            x, y = (v + _NEW_SHARE * ((new - old) / (t - self.t) - v) for old, new, v in steps)
            self.velocity = (x, y)
        self.box, self.t = box, t


class Joiner:
    """Follows boxes of one kind in one camera. The nearest pair is joined first; tracks are
    numbered from 1.

    Two who meet and turn back may take each other's number: the entries and exits are the same,
    only which belong together is not. Deterministic; at most ``TRACKS_MAX`` tracks, those not seen
    for `LOST_SECONDS` are forgotten.
    """

    def __init__(self) -> None:
        self._tracks: dict[int, _Track] = {}
        self._count = 0

    def ids(self, boxes: Sequence[Box], t: float) -> list[int | None]:
        """For each box of the frame at ``t`` its track's number; None where there are too many."""
        self._tracks = {
            n: track for n, track in self._tracks.items() if abs(t - track.t) <= LOST_SECONDS
        }
        found: dict[int, int] = {}
        taken: set[int] = set()
        for _, number, index in sorted(self._pairs(boxes, t)):
            if number not in taken and index not in found:
                found[index] = number
                taken.add(number)
                self._tracks[number].move(boxes[index], t)
        return [found.get(index) or self._begin(box, t) for index, box in enumerate(boxes)]

    def _begin(self, box: Box, t: float) -> int | None:
        if len(self._tracks) >= TRACKS_MAX:
            return None
        self._count += 1
        self._tracks[self._count] = _Track(box, t)
        return self._count

    def _pairs(self, boxes: Sequence[Box], t: float) -> list[tuple[float, int, int]]:
        """(distance, track, index of the box) of all that are near enough to be the same."""
        pairs = []
        for number, track in self._tracks.items():
            there = track.at(t)
            for index, box in enumerate(boxes):
                distance = math.dist(there, _middle(box))
                if distance <= REACH * min(_larger_side(track.box), _larger_side(box)):
                    pairs.append((distance, number, index))
        return pairs


def _middle(box: Box) -> Point:
    return (box[0] + box[2]) / 2, (box[1] + box[3]) / 2


def _larger_side(box: Box) -> float:
    return max(box[2] - box[0], box[3] - box[1])
