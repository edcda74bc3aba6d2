"""Blobs from moving pixels: boxes with a foot point; fragments of one person are merged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from camtopod.vision.boxes import OBJECTS_MAX, Box, area, union
from camtopod.vision.detect.background import Luma
from camtopod.vision.detect.motion import Motion

AREA_SHARE_MIN = 0.0004
"""Smallest blob as a share of the image's area."""
FILL_SHARE_MIN = 0.2
"""Smallest share of its box that a person fills."""
SPARSE_SHARE_MAX = 0.28
"""Share of its box that a group fills below which a person may be but a part of it."""
PART_FILL_SHARE_MIN = 0.3
"""Smallest share of its box that a person fills who was cut out of a sparse group."""
DENSE_SHARE = 0.5
"""Smallest share of the fullest column that another column of a person fills."""
TALLER = 1.2
"""Largest height of a person in heights that are expected there."""
LINE_SHARE = 0.1
"""Smallest share of its length that an object is thick; a line is the edge of something, as of a
door leaf that swings or of a shadow."""
NEAR = 0.04
"""Largest gap beside a small fragment of a person, in heights, and its area in heights squared."""
_CLOSE = np.ones((3, 1), np.uint8)

ExpectedHeight = Callable[[float], float | None]
"""Height in pixels of a person whose feet are in a given row; None while unknown."""


@dataclass(frozen=True, slots=True)
class Blob:
    """A moving region. In pixels of the working image; right and bottom are exclusive."""

    left: float
    top: float
    right: float
    bottom: float
    foot_x: float
    begins: bool = True
    """It may begin a track; otherwise it only continues one."""
    whole: bool = True
    """False if another blob may be a part of the same object, whatever heights are expected."""
    label: str = ""
    """What a detector says that it is; empty if it is not known."""

    @property
    def box(self) -> Box:
        """Left, top, right, bottom."""
        return (self.left, self.top, self.right, self.bottom)

    @property
    def width(self) -> float:
        """Width, pixels."""
        return self.right - self.left

    @property
    def height(self) -> float:
        """Height, pixels."""
        return self.bottom - self.top

    @property
    def is_line(self) -> bool:
        """It is too thin for an object, unless an edge of the view cuts it."""
        return min(self.width, self.height) < LINE_SHARE * max(self.width, self.height)

    @property
    def foot(self) -> tuple[float, float]:
        """Foot point: middle column of the lowest fifth, in the bottom row."""
        return (self.foot_x, self.bottom)


def find_blobs(motion: Motion, expected_height: ExpectedHeight) -> list[Blob]:
    """Return the blobs of a frame, in no particular order."""
    if not cv2.countNonZero(motion.moving_mask):
        return []
    mask = cv2.morphologyEx(motion.moving_mask, cv2.MORPH_CLOSE, _CLOSE)

    # Connected fragments of half of the smallest blob, the largest if there are too many.
    labels, stats = _fragments(mask)
    areas = stats[1:, cv2.CC_STAT_AREA]
    area_min = AREA_SHARE_MIN * mask.size
    numbers = np.argsort(areas, kind="stable")[-OBJECTS_MAX:]
    numbers = 1 + numbers[areas[numbers] >= area_min / 2]

    # Merge fragments of one person.
    groups = _merge([(int(label), _box(stats[label])) for label in numbers], cache(expected_height))
    parts = [(group, *_dense_part(group, box, labels, areas)) for group, box in groups]
    groups = [
        (group, box)
        for group, box, filled in parts
        if filled >= max(area_min, FILL_SHARE_MIN * area(box))
    ]
    boxes = [box for _, box in groups]
    return [
        _blob(
            group,
            box,
            labels,
            not motion.is_dim
            and not any(_belong(box, other_box) for other_box in boxes if other_box is not box),
        )
        for group, box in groups
    ]


def _dense_part(group: list[int], box: Box, labels: Luma, areas: Luma) -> tuple[Box, int]:
    """Return the part of a group's box that may be a person, and the pixels that it fills.

    A person who hangs together with something thin, as the outline of a hard shadow, is where the
    columns are fullest; leaves in the wind are full nowhere, and are left whole.
    """
    filled = sum(int(areas[label - 1]) for label in group)
    if filled >= SPARSE_SHARE_MAX * area(box):
        return box, filled
    left, top, right, bottom = map(int, box)
    mask = np.isin(labels[top:bottom, left:right], group)
    by_column = mask.sum(axis=0)
    fullest = int(by_column.argmax())
    sparse = np.flatnonzero(by_column < DENSE_SHARE * by_column[fullest])
    begin = int(sparse[sparse < fullest].max(initial=-1)) + 1
    end = int(sparse[sparse > fullest].min(initial=right - left))
    rows = np.flatnonzero(mask[:, begin:end].any(axis=1)).tolist()
    part = (left + begin, top + rows[0], left + end, top + rows[-1] + 1)
    part_filled = int(by_column[begin:end].sum())
    return (part, part_filled) if part_filled >= PART_FILL_SHARE_MIN * area(part) else (box, filled)


def _fragments(mask: Luma) -> tuple[Luma, Luma]:
    """Return the label of each pixel of ``mask`` (0: outside) and OpenCV's table of the labels.

    The cost of labelling grows with the area, so it is limited to the bounding box of the mask.
    """
    labels: Luma = np.zeros(mask.shape, np.int32)
    left, top, width, height = cv2.boundingRect(mask)
    part = slice(top, top + height), slice(left, left + width)
    _, labels[part], stats, _ = cv2.connectedComponentsWithStats(mask[part], connectivity=8)
    stats[:, : cv2.CC_STAT_TOP + 1] += (left, top)
    return labels, stats


def _box(row: cv2.typing.MatLike) -> Box:
    left, top, width, height = map(float, row[:4].tolist())
    return (left, top, left + width, top + height)


def _blob(group: list[int], box: Box, labels: Luma, whole: bool) -> Blob:
    """Return the blob of some fragments; its foot is in the middle of the lowest fifth."""
    left, top, right, bottom = map(int, box)
    lowest = labels[bottom - max(1, (bottom - top) // 5) : bottom, left:right]
    feet = np.flatnonzero(np.any([lowest == label for label in group], axis=(0, 1)))
    return Blob(left, top, right, bottom, left + float(feet[0] + feet[-1] + 1) / 2, whole=whole)


def _merge(
    fragments: list[tuple[int, Box]], expected_height: ExpectedHeight
) -> list[tuple[list[int], Box]]:
    """Group the labels that belong to one person; return the groups with their boxes."""
    groups = [([label], box) for label, box in fragments]
    has_merged = True
    while has_merged:
        has_merged = False
        for i in range(len(groups)):
            for j in range(len(groups) - 1, i, -1):
                if _belong(groups[i][1], groups[j][1], expected_height):
                    labels, box = groups.pop(j)
                    groups[i] = (groups[i][0] + labels, union(groups[i][1], box))
                    has_merged = True
    return groups


def _belong(a: Box, b: Box, expected_height: ExpectedHeight = lambda row: None) -> bool:
    """Return True if two boxes are parts of one person: one is above the other, or small and near.

    While the height of people is not known, twice the taller box is allowed.
    """
    expected = expected_height(max(a[3], b[3]))
    tallest = TALLER * expected if expected else 2 * max(a[3] - a[1], b[3] - b[1])
    if max(a[3], b[3]) - min(a[1], b[1]) > tallest:
        return False
    overlap = min(a[2], b[2]) - max(a[0], b[0])
    if 2 * overlap >= min(a[2] - a[0], b[2] - b[0]):
        return True
    gap = max(a[1], b[1]) - min(a[3], b[3])
    small = min(area(a), area(b)) < NEAR * tallest**2
    return small and max(gap, -overlap) <= NEAR * tallest
