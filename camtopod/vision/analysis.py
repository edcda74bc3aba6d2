"""What the pipeline made of one frame, for its observer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from camtopod.records import Event
from camtopod.vision.detect import Luma
from camtopod.vision.detector.detector import DetectorResult
from camtopod.vision.track import Decision, Track


class Analysis(NamedTuple):
    """One frame and its analysis.

    Holds the pipeline's own objects, which change with the next frame.
    """

    t: float
    """Capture time, seconds."""
    frame: Luma
    """The working image (H, W), filtered if it was noisy."""
    moving: Luma | None
    """Mask (H, W) of the foreground; None while most of the image differs from the background."""
    tracks: Sequence[Track]
    """Tracks that are followed, tentative ones included."""
    lost: Sequence[Track]
    """Tracks lost in mid-view that may still be found again."""
    learned_doors: Sequence[tuple[float, float]]
    """Foot points of learned doors, pixels."""
    events: Sequence[Event]
    """Events that have become certain in this frame."""
    decisions: Sequence[Decision]
    """Beginnings and ends of tracks that were decided in this frame."""
    detector: DetectorResult | None = None
    """What the detector found; None if there is none."""


Observer = Callable[[Analysis], None]
"""Called with every analysed frame."""
