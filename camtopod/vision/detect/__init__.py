"""detect"""

from __future__ import annotations

from camtopod.vision.detect.background import Luma
from camtopod.vision.detect.blobs import Blob, find_blobs
from camtopod.vision.detect.motion import Box, MotionDetector
from camtopod.vision.detect.shrink import shrunk

__all__ = [
    "Blob",
    "Box",
    "Luma",
    "MotionDetector",
    "find_blobs",
    "shrunk",
]
