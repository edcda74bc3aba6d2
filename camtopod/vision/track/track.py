"""One object followed through the view, and what a frame changes about all of them."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from camtopod.vision.detect import Box
from camtopod.vision.track.kalman import Kalman, Vector

HISTORY_SIGHTINGS = 16
"""So many of an object's latest sightings are kept."""


@dataclass(slots=True, eq=False)
class Track:
    """One object followed through the view."""

    number: int
    first: Sighting
    last: Sighting
    kalman: Kalman
    height: float
    width: float
    from_start: bool
    beside_others: bool
    """Born next to another object: rather half of a group than somebody new."""
    history: deque[Sighting] = field(default_factory=lambda: deque(maxlen=HISTORY_SIGHTINGS))
    sightings: int = 1
    frames: int = 1
    confirmed: bool = False
    covered: bool = False
    entered: bool = False
    """An entry was reported for it."""
    interrupted: bool = False
    """There were no pictures when it was lost."""
    reach: float = 0.0
    """The farthest its head or foot has been from where it began, pixels."""
    origin: Vector = (0.0, 0.0, 0.0, 0.0)
    cut_t: float = float("-inf")
    """When a side of the picture cut it last, seconds."""
    measured_at: tuple[float, float] = (0.0, 0.0)
    """Foot point where its height was last taken."""

    @property
    def box(self) -> Box:
        """Where it is expected now."""
        x, top, foot_x, bottom = self.kalman.position
        middle = (x + foot_x) / 2
        return (middle - self.width / 2, min(top, bottom - 1), middle + self.width / 2, bottom)

    def unseen_seconds(self, t: float) -> float:
        """Since the last sighting."""
        return t - self.last.t


@dataclass(frozen=True, slots=True)
class Changes:
    """What one frame changed: tracks that became objects, and objects whose track is over.

    ``left``: out of sight at an edge of the view; ``vanished``: out of sight in mid-view and not
    found again.
    """

    appeared: list[Track]
    left: list[Track]
    vanished: list[Track]


class Sighting(NamedTuple):
    """Time in seconds, foot point and box in pixels of the working picture."""

    t: float
    foot: tuple[float, float]
    box: Box
