"""Doors in mid-view: places away from the border where people repeatedly appear and disappear.

Some may be named by the operator (setting `doors`): they are doors from the start and remain so.
The others are learned.

A single track that begins or ends in mid-view is most often an error: somebody stepped out of a
group or behind a tree, or stood still until the track was lost. A place becomes a door only when
several tracks began or ended there without another explanation, and more of them than walked
through. Until then no events are reported there.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from math import dist
from typing import Literal

import cv2
import numpy as np

from camtopod.vision.settings import Polygon
from camtopod.vision.track.stature import SAMPLES_MAX

Door = Literal["named door", "learned door"]
"""How a place is known to be a door."""

DOOR_EVENTS_MIN = 2
"""Unexplained beginnings and ends of tracks that make a door."""
DOOR_HEIGHTS = 0.6
"""Radius around a foot point in which they count (heights of the person)."""
GRID = (24, 32)
"""Rows and columns of the cells of the image in which passing objects are counted."""


class Doors:
    """Doors of one view, named and learned; positions in pixels of the working image.

    polygons: doors of the settings, in fractions of the image.
    """

    def __init__(self, width: int, height: int, polygons: Sequence[Polygon] = ()) -> None:
        self._size = (width, height)
        self._polygons = [
            np.array([(x * width, y * height) for x, y in polygon], np.float32)
            for polygon in polygons
        ]
        self._unexplained_points: deque[tuple[float, float]] = deque(maxlen=SAMPLES_MAX)
        self._pass_counts = np.zeros(GRID, np.int32)

    def cell(self, x: float, y: float) -> tuple[int, int]:
        """Return the grid cell (row, column) of a foot point."""
        row, column = int(y / self._size[1] * GRID[0]), int(x / self._size[0] * GRID[1])
        return min(max(row, 0), GRID[0] - 1), min(max(column, 0), GRID[1] - 1)

    def record_unexplained(self, foot: tuple[float, float]) -> None:
        """Record that a track began or ended at a foot point in mid-view, without explanation."""
        self._unexplained_points.append(foot)

    def record_walk(self, feet: set[tuple[int, int]]) -> None:
        """Record that an object crossed these cells without beginning or ending there.

        feet: cells as returned by `cell`.
        """
        for row, column in feet:
            self._pass_counts[row, column] += 1

    def door_at(self, x: float, y: float, height: float) -> Door | None:
        """Return which door an object uses that begins or ends at this foot point, if any.

        height: the object's height, pixels.
        """
        radius = DOOR_HEIGHTS * height
        if any(_is_at(place, x, y, radius) for place in self._polygons):
            return "named door"
        near = sum(dist(place, (x, y)) <= radius for place in self._unexplained_points)
        if near >= DOOR_EVENTS_MIN and near > int(self._pass_counts[self.cell(x, y)]):
            return "learned door"
        return None

    def learned(self, height: Callable[[float], float | None]) -> list[tuple[float, float]]:
        """Return foot points of learned doors, at most one of each grid cell.

        height: expected height (pixels) of a person whose feet are in a given row, if known; else a
            tenth of the image's height is taken.
        """
        places = {self.cell(x, y): (x, y) for x, y in self._unexplained_points}
        return [
            (x, y)
            for x, y in places.values()
            if self.door_at(x, y, height(y) or 0.1 * self._size[1]) == "learned door"
        ]


def _is_at(place: cv2.typing.MatLike, x: float, y: float, radius: float) -> bool:
    """Return True if (x, y) is inside a polygon (N, 2), or within ``radius`` of a single point."""
    if len(place) == 1:
        return bool(np.hypot(place[0, 0] - x, place[0, 1] - y) <= radius)
    return cv2.pointPolygonTest(place, (x, y), measureDist=False) >= 0
