"""Whether a detector is trusted at a camera, and the objects that it then finds.

There are two modes and nothing in between. *Not trusted*: objects are the blobs of motion alone.
*Trusted*: objects are the detector's boxes, and blobs only say whether a box moves, and whether
its object reaches the border of the image.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from camtopod.vision.boxes import TOUCH_PIXELS, Box, Size, box_height, centre, overlap, pixels
from camtopod.vision.detect import Blob, Luma
from camtopod.vision.detector.model import Detection

TRUSTED_FROM = 0.6
"""Share of the moving area inside of boxes from which a detector is trusted."""
TRUSTED_DOWN_TO = 0.45
"""The share below which it is trusted no longer."""
PRIOR = 0.25
"""The share before the first inference: a camera begins with motion alone."""
PRIOR_AREA = 0.03
"""Moving area (share of the image) that counts as much as the prior."""
INFERENCES_MEMORY = 200
"""Inferences after which a moving area counts 1/e as much."""
OVERLAP_MIN = 0.3
"""Least overlap (share of the smaller box) of a detection with its motion, or with its track."""
BORDER_HEIGHTS = 0.15
"""Distance from the border (heights) within which a box ends there, if its motion does."""


class Trust:
    """Running share of the moving area that is inside of a detector's boxes.

    It needs no ground truth: a detector sees most of what moves (0.7 to 0.9), or hardly any of it
    (0.1 and less), as people from above, or cars where it looks for people.
    """

    def __init__(self) -> None:
        self._area = PRIOR_AREA
        self._inside = PRIOR * PRIOR_AREA
        self.trusted = False
        """True if objects are the boxes, not the blobs."""

    def add(self, moving: Luma, boxes: Sequence[Box]) -> None:
        """Update with one inference: mask of moving pixels (H, W), and boxes in its pixels."""
        outside = moving != 0
        area = int(np.count_nonzero(outside)) / moving.size
        for box in boxes:
            outside[pixels(box, moving.shape)] = False
        inside = area - int(np.count_nonzero(outside)) / moving.size
        kept = 1.0 - 1.0 / INFERENCES_MEMORY
        self._area = kept * self._area + area
        self._inside = kept * self._inside + inside
        self.trusted = self.share >= (TRUSTED_DOWN_TO if self.trusted else TRUSTED_FROM)

    @property
    def share(self) -> float:
        """The running share, 0 to 1."""
        return self._inside / self._area


def objects(
    detections: Sequence[Detection],
    blobs: Sequence[Blob],
    tracked: Sequence[Box],
    size: Size,
    score_min: float,
) -> list[Blob]:
    """Return the objects in a frame of a trusted detector.

    A box counts where something is tracked, whether it moves or not. Elsewhere it has to move, and
    to have at least ``score_min``; then it may begin a track (ByteTrack: Y. Zhang et al., 2022).

    detections, blobs, tracked: in pixels of the working image, which has ``size``.
    """
    found = []
    for one in detections:
        motion = [blob.box for blob in blobs if overlap(blob.box, one.box) >= OVERLAP_MIN]
        begins = bool(motion) and one.score >= score_min
        if begins or any(overlap(box, one.box) >= OVERLAP_MIN for box in tracked):
            box = _to_border(one.box, motion, size)
            found.append(Blob(*box, centre(box)[0], begins))
    return found


def _to_border(box: Box, motion: Sequence[Box], size: Size) -> Box:
    """Return a box up to the border of the image, where it is near and its motion touches it.

    A detector finds less of a person whom the border cuts.
    """
    reach = BORDER_HEIGHTS * box_height(box)
    ends = (0.0, 0.0, float(size[0]), float(size[1]))
    left, top, right, bottom = (
        end
        if abs(value - end) <= reach
        and any(abs(blob[side] - end) <= TOUCH_PIXELS for blob in motion)
        else value
        for side, (value, end) in enumerate(zip(box, ends, strict=True))
    )
    return (left, top, right, bottom)
