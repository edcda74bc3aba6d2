"""How far the picture lies off the scene: a least-squares step of Lucas and Kanade (IJCAI 1981)."""

from __future__ import annotations

import numpy as np

from camtopod.vision.background import Luma

_ROW_STEP = 4
_OUTLIER = 40.0
"""Grey levels; a larger difference is an object rather than a shift of a pixel."""


def shift(frame: Luma, scene: Luma, settled: Luma) -> tuple[float, float]:
    """(x, y) in pixels by which ``frame`` lies off ``scene``, judged where ``settled`` is not 0.

    One step, so good to a pixel or so. (0, 0) where the scene has too little texture to tell.
    """
    rows, columns = slice(1, -1, _ROW_STEP), slice(1, -1)
    middle = scene[rows, columns].astype(np.float32)
    difference = middle - frame[rows, columns]
    good = (settled[rows, columns] != 0) & (np.abs(difference) < _OUTLIER)
    dx = ((scene[rows, 2:].astype(np.float32) - scene[rows, :-2]) / 2)[good]
    count = middle.shape[0]
    below, above = scene[2::_ROW_STEP, columns][:count], scene[:-2:_ROW_STEP, columns][:count]
    dy = ((below.astype(np.float32) - above) / 2)[good]
    difference = difference[good]
    xx, xy, yy = float(dx @ dx), float(dx @ dy), float(dy @ dy)
    determinant = xx * yy - xy * xy
    if determinant <= 1e-3 * max(xx, yy, 1.0) ** 2:
        return (0.0, 0.0)
    bx, by = float(dx @ difference), float(dy @ difference)
    return ((yy * bx - xy * by) / determinant, (xx * by - xy * bx) / determinant)
