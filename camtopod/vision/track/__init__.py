"""track"""

from __future__ import annotations

from camtopod.vision.track.crossings import Crossings, went_somewhere
from camtopod.vision.track.track import Track
from camtopod.vision.track.tracker import Tracker

__all__ = [
    "Crossings",
    "Track",
    "Tracker",
    "went_somewhere",
]
