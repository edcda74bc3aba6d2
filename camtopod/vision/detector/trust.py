"""Whether a detector is trusted at a camera, and the objects that it then finds.

There are two modes and nothing in between. *Not trusted*: objects are the blobs of motion alone.
*Trusted*: objects are the detector's boxes, and blobs only say whether a box moves, and whether
its object reaches the border of the image.
"""

from __future__ import annotations

from collections.abc import Sequence

from camtopod.vision.boxes import Box, box_height, centre, iou, overlap, pixels, to_border
from camtopod.vision.detect import FILL_SHARE_MIN, Blob, Luma
from camtopod.vision.detector.model import Detection

TRUSTED_FROM = 0.7
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
"""Least IoU of a box with the track that it continues; the same for the overlap with its motion."""
BORDER_HEIGHTS = 0.15
"""Distance from the border (heights) within which a box ends there, if its motion does."""


class Trust:
    """Running share of the moving area that is inside of a detector's boxes.

    It needs no ground truth: a detector sees most of what moves (0.7 to 0.9), people from above
    less well (0.6 to 0.7), or hardly anything (0.1 and less), as cars where it looks for people.
    """

    def __init__(self) -> None:
        self._area = PRIOR_AREA
        self._inside = PRIOR * PRIOR_AREA
        self.is_trusted = False
        """True if objects are the boxes, not the blobs."""

    def add(self, area: float, outside: float) -> None:
        """Update with an inference: moving area, its part in no box, as shares of the image."""
        decay = 1.0 - 1.0 / INFERENCES_MEMORY
        self._area = decay * self._area + area
        self._inside = decay * self._inside + area - outside
        self.is_trusted = self.share >= (TRUSTED_DOWN_TO if self.is_trusted else TRUSTED_FROM)

    @property
    def share(self) -> float:
        """The running share, 0 to 1."""
        return self._inside / self._area


def objects(
    detections: Sequence[Detection],
    moving_mask: Luma,
    blobs: Sequence[Blob],
    track_boxes: Sequence[Box],
    view: Box,
    score_min: float,
) -> tuple[list[Blob], float]:
    """Return the objects of a trusted detector, and the moving area that they do not explain.

    A box counts where something is tracked, whether it moves or not. Elsewhere it needs motion
    that better boxes do not explain, in as much of it as a blob has of its box, and at least
    ``score_min``; then it may begin a track (ByteTrack: Y. Zhang et al., 2022). What stands and
    only looks like a person begins none, also while others pass it.

    moving_mask (H, W): mask of moving pixels of the working image; boxes are in its pixels, areas
        in shares of it.
    view: part of the scene that the image shows, pixels.
    """
    free_pixels = moving_mask != 0
    result = []
    for detection in sorted(detections, key=lambda detection: -detection.score):
        part = free_pixels[pixels(detection.box, moving_mask.shape)]
        begins = detection.score >= score_min and bool(
            part.sum() >= FILL_SHARE_MIN * max(part.size, 1)
        )
        if begins or any(iou(detection.box, box) >= OVERLAP_MIN for box in track_boxes):
            part[:] = False
            motion = [blob.box for blob in blobs if overlap(blob.box, detection.box) >= OVERLAP_MIN]
            reach = BORDER_HEIGHTS * box_height(detection.box)
            box = to_border(detection.box, motion, view, reach)
            result.append(Blob(*box, centre(box)[0], begins, label=detection.label))
    return result, float(free_pixels.mean())
