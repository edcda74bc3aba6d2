"""Motion and detections of one frame -> the blobs that are tracked.

Used only where the detector is trusted. A blob with one detection keeps its outline, which is
steadier than the box of a detection, if the two are much alike; otherwise the box of the detection
replaces it, which joins pieces and drops shadows. A blob with several detections is split. A blob
without a detection stays as it is: it dates entries and exits, as a detector finds people late at
the border. A detection without motion is kept if it is tracked: a person who stands.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from camtopod.vision.boxes import (
    TOUCH_PIXELS,
    Box,
    Size,
    area,
    box_height,
    centre,
    common_area,
    intersection,
    overlap,
)
from camtopod.vision.detect import Blob, Luma

LINK_SHARE = 0.4
"""Least share of a detection, or half of a blob, that they have in common to be of one object."""
SAME_SHARE = 0.5
"""Least overlap (share of the smaller box) of a track and a detection of one object."""
MOVING_SHARE = 0.25
"""Least share of moving pixels in the box of a track that is not detected, beside detections."""
BORDER_HEIGHTS = 0.15
"""Distance from the border (heights) within which a detection ends there, if its motion does."""
SAME_IOU = 0.5
"""IoU above which two boxes are of one object."""


class TrackedBox(NamedTuple):
    """Expected box of a track."""

    box: Box
    """Pixels of the working image."""
    confirmed: bool
    still: bool
    """It has not moved for some seconds."""


def fuse(
    blobs: Sequence[Blob],
    detections: Sequence[Box],
    tracked: Sequence[TrackedBox],
    moving: Luma,
) -> list[Blob]:
    """Return the blobs of a frame as the detector sees them.

    detections: boxes of objects.
    tracked: the tracks.
    moving (H, W): mask of moving pixels.

    All in pixels of the working image.
    """
    height, width = moving.shape
    image = (0.0, 0.0, float(width), float(height))
    shown = [(one, box) for one in tracked if (box := intersection(one.box, image)) is not None]
    links = [[d for d, box in enumerate(detections) if _linked(blob.box, box)] for blob in blobs]
    fused = []

    # Blobs without a detection.
    for blob, own in zip(blobs, links, strict=True):
        if not own:
            fused.append(blob)

    # Detections: one blob each.
    found = []
    for d, box in enumerate(detections):
        own_blobs = [b for b, own in enumerate(links) if d in own]
        if not own_blobs and not any(same_object(track, box) for _, track in shown):
            continue
        alone = own_blobs[0] if len(own_blobs) == 1 and len(links[own_blobs[0]]) == 1 else None
        others = [track for one, track in shown if one.confirmed and not same_object(track, box)]
        if (
            alone is not None
            and same_outline(blobs[alone].box, box)
            and not any(same_object(track, blobs[alone].box) for track in others)
        ):
            found.append(blobs[alone])  # it is one, as detected
            continue
        outline = _to_border(box, [blobs[b].box for b in own_blobs], (width, height))
        found.append(_blob(outline))

    # Tracked objects that move within a blob of others and are not detected in this frame.
    boxes = [blob.box for blob in found]
    for one, track in shown:
        if not one.confirmed or any(same_object(track, box) for box in boxes):
            continue
        for b, blob in enumerate(blobs):
            rest = intersection(track, blob.box)
            if links[b] and rest is not None and _moves_beside(rest, track, boxes, moving):
                fused.append(_blob(rest))
                break
    return fused + found


def same_object(track: Box, detection: Box) -> bool:
    """Return True if a track and a detection are of one object."""
    return overlap(track, detection) >= SAME_SHARE


def same_outline(a: Box, b: Box) -> bool:
    """Return True if two boxes have the same outline, nearly."""
    common = common_area(a, b)
    return common > SAME_IOU * (area(a) + area(b) - common)


def share_inside(moving: Luma, crop: Box, boxes: Sequence[Box]) -> tuple[int, int]:
    """Return how many moving pixels a crop has, and how many are inside of boxes.

    moving (H, W): mask of moving pixels; crop and boxes in its pixels.
    """
    rows, columns = _slices(crop, moving)
    mask = moving[rows, columns] != 0
    inside = np.zeros(moving.shape, bool)
    for box in boxes:
        inside[_slices(box, moving)] = True
    return int(np.count_nonzero(mask)), int(np.count_nonzero(mask & inside[rows, columns]))


def _linked(blob: Box, detection: Box) -> bool:
    """Return True if a blob shows a piece of a detected object, or contains it."""
    shared = common_area(blob, detection)
    return shared >= LINK_SHARE * area(detection) or shared >= 0.5 * area(blob)


def _to_border(box: Box, blobs: Sequence[Box], size: Size) -> Box:
    """Return a detection's box up to the border, where it is near and its motion touches it."""
    reach = max(3.0, BORDER_HEIGHTS * box_height(box))
    ends = (0.0, 0.0, float(size[0]), float(size[1]))
    sides = []
    for side, (value, end) in enumerate(zip(box, ends, strict=True)):
        touched = any(abs(blob[side] - end) <= TOUCH_PIXELS for blob in blobs)
        sides.append(end if touched and abs(value - end) <= reach else value)
    return (sides[0], sides[1], sides[2], sides[3])


def _moves_beside(rest: Box, track: Box, others: Sequence[Box], moving: Luma) -> bool:
    """Return True if enough of a track's box moves outside of the boxes of others.

    rest: the part of it that is in a blob; track: the part that is in the image.
    """
    if area(rest) < SAME_SHARE * area(track):
        return False
    count, covered = share_inside(moving, rest, others)
    return count - covered >= MOVING_SHARE * area(track)


def _blob(box: Box) -> Blob:
    """Return a blob with the foot in the middle of the box's bottom."""
    return Blob(*box, centre(box)[0])


def _slices(box: Box, image: Luma) -> tuple[slice, slice]:
    """Return the rows and columns of a box that are in the image."""
    height, width = image.shape
    left, right = (min(max(round(x), 0), width) for x in (box[0], box[2]))
    top, bottom = (min(max(round(y), 0), height) for y in (box[1], box[3]))
    return slice(top, bottom), slice(left, right)
