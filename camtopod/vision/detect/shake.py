"""Shift of an image against the scene: least-squares steps of Lucas and Kanade (IJCAI 1981)."""

from __future__ import annotations

from math import hypot

import cv2
import numpy as np
import numpy.typing as npt

from camtopod.vision.detect.background import Luma

STEPS_MAX = 10
"""Largest number of steps to align a frame; a single one is accurate to about a pixel."""
EXACT_PIXELS = 0.05
"""Length of a step (pixels) below which the alignment has converged."""
SHIFT_PIXELS_MAX = 20.0
"""Largest shift (pixels) that is corrected; a larger one means that the camera was turned."""
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
    below = scene[2::_ROW_STEP, columns][:count]
    above = scene[:-2:_ROW_STEP, columns][:count]

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


def shifted_back(frame: Luma, scene: Luma, settled: Luma, first: tuple[float, float]) -> Luma:
    """Return ``frame`` (H, W) aligned with ``scene``; the border is filled by repeating its pixels.

    settled (H, W): 0 where the frame does not show the scene.
    first (pixels): shift of the frame as found by `shift`; further steps refine it.
    """
    x, y = first
    aligned = _moved(frame, x, y)
    for _ in range(STEPS_MAX):
        dx, dy = shift(aligned, scene, settled)
        if hypot(dx, dy) < EXACT_PIXELS:
            break
        x, y = x + dx, y + dy
        aligned = _moved(frame, x, y)
    return aligned if hypot(x, y) <= SHIFT_PIXELS_MAX else frame


def _moved(frame: Luma, x: float, y: float) -> Luma:
    """Return ``frame`` moved by (-x, -y) pixels."""
    height, width = frame.shape
    return cv2.warpAffine(
        frame,
        np.array([[1.0, 0.0, x], [0.0, 1.0, y]]),
        (width, height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )


def _flat(values: npt.NDArray[np.int16]) -> npt.NDArray[np.float32]:
    return values.astype(np.float32).ravel()
