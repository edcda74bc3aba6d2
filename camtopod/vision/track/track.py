"""State of one tracked object."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import inf
from typing import NamedTuple

from camtopod.vision.boxes import Box, centre
from camtopod.vision.track.decisions import Shortfall
from camtopod.vision.track.kalman import Kalman, Vector

HISTORY_SIGHTINGS = 16
"""Sightings kept of an object, the newest."""
WIDTH_SHARE = 0.7
"""Share of the width that counts as the size of wide objects, such as cars."""

Unmet = tuple[Shortfall, float, float]
"""Condition of an object that is not met, what was measured, and what an object has at least."""


@dataclass(slots=True, eq=False)
class Track:
    """One tracked object. Lengths in pixels, times in seconds."""

    number: int
    """Number of the track; it stays the same for a whole passage."""
    first: Sighting
    last: Sighting
    kalman: Kalman
    height: float
    width: float
    from_start: bool
    """In view when tracking began, at first or after a pause; an entry only if it just came in."""
    beside_others: bool
    """Began next to another object: more likely half of a group than a new person."""
    unmet_condition: Unmet | None
    """Condition that a tentative track did not meet in the latest frame that showed it."""
    history: deque[Sighting]
    """The newest `HISTORY_SIGHTINGS`."""
    sightings: int = 1
    frames: int = 1
    """Frames since the first sighting."""
    is_occluded: bool = False
    """Occluded by others in the latest frame."""
    cells: set[tuple[int, int]] = field(default_factory=set)
    """Grid cells (row, column) of the image in which its foot was."""
    began_in_view: bool = False
    """Began in mid-view without explanation, and has not walked far enough yet to be evidence."""
    reach: float = 0.0
    """Largest distance of head or foot from where it began, pixels."""
    measured_at: tuple[float, float] = (0.0, 0.0)
    """Foot point where its height was last measured."""
    labels: dict[str, int] = field(default_factory=dict)
    """Sightings by label."""

    @property
    def confirmed(self) -> bool:
        """It meets the conditions of an object, or has met them once."""
        return self.unmet_condition is None

    @property
    def size(self) -> float:
        """Size that decides how far it may move: its height, or most of its width, pixels."""
        return max(self.height, WIDTH_SHARE * self.width)

    @property
    def box(self) -> Box:
        """Expected box."""
        x, top, foot_x, bottom = self.kalman.position
        middle = (x + foot_x) / 2
        return (middle - self.width / 2, min(top, bottom - 1), middle + self.width / 2, bottom)

    @property
    def velocity(self) -> tuple[float, float]:
        """Mean velocity of the box's middle over the sightings kept, pixels per second.

        Unlike the foot, the middle moves on while an ignored area covers more and more of the
        object.
        """
        first = self.history[0]
        last = self.history[-1]
        dt = last.t - first.t or inf
        x, y = centre(first.box)
        x_2, y_2 = centre(last.box)
        return ((x_2 - x) / dt, (y_2 - y) / dt)


class Sighting(NamedTuple):
    """Time (seconds), foot point and box (pixels of the working image)."""

    t: float
    foot: tuple[float, float]
    box: Box

    @property
    def points(self) -> Vector:
        """Head, the middle of the upper side, and foot."""
        left, top, right, _ = self.box
        return ((left + right) / 2, top, *self.foot)
