"""Pixels -> events: capture, noise reduction, motion, tracks, crossings of the border of the
view.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import names_from

if TYPE_CHECKING:
    from camtopod.vision.grabber import Grabber
    from camtopod.vision.settings import VisionSettings

__all__ = [
    "Grabber",
    "VisionSettings",
]

__getattr__ = names_from(
    __name__,
    {
        "Grabber": "grabber",
        "VisionSettings": "settings",
    },
)
