"""next_camera"""

from __future__ import annotations

from camtopod.learn.next_camera.contexts import LEVELS
from camtopod.learn.next_camera.fit import Posterior, fit_followed, followed_of
from camtopod.learn.next_camera.overlapping_views import (
    Overlapping,
    find_overlapping,
    table_of,
    views_of,
)

__all__ = [
    "LEVELS",
    "Overlapping",
    "Posterior",
    "find_overlapping",
    "fit_followed",
    "followed_of",
    "table_of",
    "views_of",
]
