"""Detection: a frame -> blobs of moving pixels.

In the order of use: `shrink` (working size), `watched` (pixels that are not ignored), `wiener`
(noise filter, thesis 4.1), `background` (model of the settled scene), `shake` (shift of the
image), `swaying` (scenery that moves in place), `motion` (moving pixels), `blobs` (boxes with a
foot point), `heads` (how many people a blob shows).
"""

from __future__ import annotations

from camtopod.vision.detect.background import Luma
from camtopod.vision.detect.blobs import Blob, find_blobs
from camtopod.vision.detect.motion import MotionDetector
from camtopod.vision.detect.shrink import shrunk
from camtopod.vision.detect.watched import ignored_share

__all__ = [
    "Blob",
    "Luma",
    "MotionDetector",
    "find_blobs",
    "ignored_share",
    "shrunk",
]
