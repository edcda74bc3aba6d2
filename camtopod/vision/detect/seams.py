"""Seams: where a picture is put together of several views, as that of a recorder or of two lenses.

They run straight from border to border, in the middle of the picture's width, height, or both.
Hardly any edge of a scene does so: the level steps along all of a seam, and what is on one side of
it does not go on at the other. Objects enter and leave by it.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from camtopod.arrays import Floats
from camtopod.vision.boxes import Box
from camtopod.vision.detect.background import Luma

STEP_MIN = 4.0
"""Least step across a seam, grey levels, mean along a part of it."""
STEP_RATIO_MIN = 2.0
"""The same over the mean of the steps beside it."""
PARTS = 16
"""Number of parts of a seam."""
PARTS_SHARE_MIN = 0.7
"""Least share of its parts with such a step; the views may be alike in the others."""
LIKENESS_MAX = 0.4
"""Largest correlation of the details along both sides of a seam."""
DETAIL_PIXELS = 31
"""Length along a seam below which something is a detail."""
REACH_PIXELS = 2
"""Largest distance of a seam from the middle: there may be a line between the views."""
BESIDE_PIXELS = 10
"""Largest distance from the middle of the steps beside a seam."""
SEAM_PIXELS = 2
"""Pixels on each side of a seam in which nothing counts."""


def find_tiles(scene: Luma, area: Box) -> list[Box]:
    """Return the views that a picture shows beside or above one another; one without a seam.

    scene (H, W): the settled scene.
    area: the part of the picture that shows something.

    Compression mixes the views along a seam, so they end `SEAM_PIXELS` before it.
    """
    left, top, right, bottom = area
    columns = _sides(_seam(scene[int(top) : int(bottom)]), left, right)
    rows = _sides(_seam(scene[:, int(left) : int(right)].T), top, bottom)
    return [
        (x, y, next_x, next_y)
        for x, next_x in zip(columns[::2], columns[1::2], strict=True)
        for y, next_y in zip(rows[::2], rows[1::2], strict=True)
    ]


def between_tiles(tiles: Sequence[Box], scene: Luma) -> Luma:
    """Return a mask (H, W): 0 in the views, 255 between and around them."""
    mask = np.full_like(scene, 255)
    for left, top, right, bottom in tiles:
        mask[round(top) : round(bottom), round(left) : round(right)] = 0
    return mask


def _sides(seam: float | None, first: float, last: float) -> list[float]:
    """Return first and last side of each view in turn, pixels."""
    if seam is None or not first + BESIDE_PIXELS < seam < last - BESIDE_PIXELS:
        return [first, last]
    return [first, seam - SEAM_PIXELS, seam + SEAM_PIXELS, last]


def _seam(scene: Luma) -> float | None:
    """Return the column (pixels) of the seam between a left and a right view; None without one."""
    height, width = scene.shape
    if height < DETAIL_PIXELS or width < 4 * BESIDE_PIXELS:
        return None
    middle = width // 2
    levels = scene[:, middle - BESIDE_PIXELS - 1 : middle + BESIDE_PIXELS + 2].astype(float)

    # Steps across, by part and column.
    across = np.abs(levels[:, 2:] - levels[:, :-2])
    steps = np.array([part.mean(axis=0) for part in np.array_split(across, PARTS)])
    near = slice(BESIDE_PIXELS - REACH_PIXELS, BESIDE_PIXELS + REACH_PIXELS + 1)
    beside = np.delete(steps, near, axis=1).mean(axis=1, keepdims=True)
    is_step = (steps[:, near] >= STEP_MIN) & (steps[:, near] >= STEP_RATIO_MIN * beside)
    shares = is_step.mean(axis=0)
    if shares.max() < PARTS_SHARE_MIN:
        return None
    at = round(float(np.flatnonzero(shares == shares.max()).mean()) + 0.5)

    # Details along both sides.
    column = BESIDE_PIXELS + 1 - REACH_PIXELS + at
    before, after = (
        _details(levels[:, columns])
        for columns in (slice(column - 7, column - 3), slice(column + 3, column + 7))
    )
    likeness = (before * after).mean() / max(before.std() * after.std(), 1e-6)
    return None if likeness > LIKENESS_MAX else float(middle - REACH_PIXELS + at)


def _details(levels: Floats) -> Floats:
    """Return the mean levels (n,) of some columns (n, columns) without what changes slowly."""
    profile = levels.mean(axis=1, keepdims=True)
    details: Floats = profile - cv2.blur(profile, (1, DETAIL_PIXELS))
    return details[:, 0]
