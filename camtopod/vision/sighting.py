"""One look at an object."""

from __future__ import annotations

from typing import NamedTuple

from camtopod.vision.motion import Box


class Sighting(NamedTuple):
    """Time in seconds, foot point and box in pixels of the working picture."""

    t: float
    foot: tuple[float, float]
    box: Box
