"""Shift of a picture against the scene: a least-squares step of Lucas and Kanade (IJCAI 1981)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from camtopod.vision.detect.background import Luma

_ROW_STEP = 4
"""Only every fourth row is used."""
_OUTLIER = 40
"""Difference (grey levels) above which a pixel shows an object rather than a shift of the scene."""


def shift(frame: Luma, scene: Luma, settled: Luma) -> tuple[float, float]:
    """Return the shift (x, y) of ``frame`` against ``scene`` in pixels, where ``settled`` is not 0.

    A single step, so accurate to about a pixel. (0, 0) if the scene has too little texture.
    """
    rows, columns = slice(1, -1, _ROW_STEP), slice(1, -1)

    # Differences of the pixels that show the settled scene.
    middle = scene[rows, columns].astype(np.int16)
    difference = middle - frame[rows, columns]
    good = (settled[rows, columns] != 0) & (np.abs(difference) < _OUTLIER)
    count = middle.shape[0]
    below, above = scene[2::_ROW_STEP, columns][:count], scene[:-2:_ROW_STEP, columns][:count]

    # Gradients, doubled to keep integers.
    dx = _flat((scene[rows, 2:].astype(np.int16) - scene[rows, :-2]) * good)
    dy = _flat((below.astype(np.int16) - above) * good)
    off = _flat(difference * good)

    # Normal equations.
    xx, xy, yy = float(dx @ dx) / 4, float(dx @ dy) / 4, float(dy @ dy) / 4
    determinant = xx * yy - xy * xy
    if determinant <= 1e-3 * max(xx, yy, 1.0) ** 2:
        return (0.0, 0.0)
    bx, by = float(dx @ off) / 2, float(dy @ off) / 2
    return ((yy * bx - xy * by) / determinant, (xx * by - xy * bx) / determinant)


def _flat(values: npt.NDArray[np.int16]) -> npt.NDArray[np.float32]:
    return values.astype(np.float32).ravel()
