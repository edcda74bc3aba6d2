"""Seams: where a picture is put together of several views, as that of a recorder or of two lenses.

They run straight from border to border, in the middle of the picture's width, height, or both.
Hardly any edge of a scene does so: the level steps along all of a seam, and what is on one side of
it does not go on at the other. Objects enter and leave by it.
"""

from __future__ import annotations

import itertools
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
    """
    left, top, right, bottom = area
    columns = [left, *(x for x in _seam(scene) if left < x < right), right]
    rows = [top, *(y for y in _seam(scene.T) if top < y < bottom), bottom]
    return [
        (x, y, next_x, next_y)
        for x, next_x in itertools.pairwise(columns)
        for y, next_y in itertools.pairwise(rows)
    ]


def seam_pixels(tiles: Sequence[Box], scene: Luma) -> Luma:
    """Return a mask (H, W): 255 along the seams of a picture, where compression mixes the views."""
    mask = np.zeros_like(scene)
    for left, top, right, bottom in tiles[1:]:
        (x, y), (next_x, next_y) = ((round(x), round(y)) for x, y in ((left, top), (right, bottom)))
        if left > tiles[0][0]:
            mask[y:next_y, x - SEAM_PIXELS : x + SEAM_PIXELS] = 255
        if top > tiles[0][1]:
            mask[y - SEAM_PIXELS : y + SEAM_PIXELS, x:next_x] = 255
    return mask


def _seam(scene: Luma) -> list[float]:
    """Return the column (pixels) of the seam between a left and a right view; empty without one."""
    height, width = scene.shape
    if height < DETAIL_PIXELS or width < 4 * BESIDE_PIXELS:
        return []
    middle = width // 2
    levels = scene[:, middle - BESIDE_PIXELS - 1 : middle + BESIDE_PIXELS + 2].astype(float)

    # Steps across, by part and column.
    across = np.abs(levels[:, 2:] - levels[:, :-2])
    steps = np.array([part.mean(axis=0) for part in np.array_split(across, PARTS)])
    near = slice(BESIDE_PIXELS - REACH_PIXELS, BESIDE_PIXELS + REACH_PIXELS + 1)
    beside = np.delete(steps, near, axis=1).mean(axis=1, keepdims=True)
    is_step = (steps[:, near] >= STEP_MIN) & (steps[:, near] >= STEP_RATIO_MIN * beside)
    shares = is_step.mean(axis=0)
    at = int(shares.argmax())
    if shares[at] < PARTS_SHARE_MIN:
        return []

    # Details along both sides.
    column = BESIDE_PIXELS + 1 - REACH_PIXELS + at
    before, after = (
        _details(levels[:, columns])
        for columns in (slice(column - 6, column - 2), slice(column + 3, column + 7))
    )
    likeness = (before * after).mean() / max(before.std() * after.std(), 1e-6)
    return [] if likeness > LIKENESS_MAX else [float(middle - REACH_PIXELS + at)]


def _details(levels: Floats) -> Floats:
    """Return the mean levels (n,) of some columns (n, columns) without what changes slowly."""
    profile = levels.mean(axis=1, keepdims=True)
    details: Floats = profile - cv2.blur(profile, (1, DETAIL_PIXELS))
    return details[:, 0]
