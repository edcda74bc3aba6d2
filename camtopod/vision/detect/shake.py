"""Alignment of an image with the scene by an affine map: shake, drift, zoom and rotation.

Least-squares steps of Lucas and Kanade (IJCAI 1981) in the inverse compositional form of Baker and
Matthews (IJCV 2004), from coarse to fine. Maps are matrices (3, 3) of coordinates that are 0 in the
middle of the image; the ends of its longer side are at -1 and 1.
"""

from __future__ import annotations

from math import hypot

import cv2
import numpy as np
import numpy.typing as npt

from camtopod.vision.detect.background import Luma

Map = npt.NDArray[np.float64]
"""Affine map from places of the scene to those of an image, (3, 3)."""
IDENTITY: Map = np.eye(3)
_FACTORS = (4, 2)
"""Images are aligned at these parts of their size; the smaller they are, the farther it reaches."""
_STEPS_MAX = 10
"""Steps to align a frame at each size at most; a single one is accurate to about a pixel."""
_OUTLIER = 40
"""Difference (grey levels) above which a pixel shows an object rather than a shift of the scene."""
_DAMPING = 1e-3
"""Changes for which the scene has less than this share of its gradients are hardly made."""


def shift(image: Luma, scene: Luma, settled: Luma) -> float:
    """Return by how many pixels ``image`` (H, W) is shifted against ``scene``, to about a pixel.

    settled (H, W): 0 where the image does not show the scene.
    """
    every = 2 * _FACTORS[0]
    return length(_step(image, scene, settled, _slopes(scene, 2, every), every), scene.shape)


def aligning(image: Luma, scene: Luma, settled: Luma, first: Map) -> Map:
    """Return the map that takes ``scene`` (H, W) to ``image``.

    settled (H, W): 0 where the image does not show the scene.
    first: where to begin; the result if nothing better is found.
    """
    height, width = scene.shape
    for factor in _FACTORS:
        size = (max(3, width // factor), max(3, height // factor))
        small, model, known = (
            cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in (image, scene, settled)
        )
        table = _slopes(model, 6, 1)
        found, least = first, float("inf")
        for _ in range(_STEPS_MAX):
            aligned = warped(small, model, found)
            off = cv2.absdiff(aligned, model)
            residual = cv2.mean(np.minimum(off, np.uint8(_OUTLIER)), known)[0]
            if residual >= least:
                break
            first, least = found, residual
            found = found @ _step(aligned, model, known, table, 1)
    return first


def warped(image: Luma, scene: Luma, by: Map) -> Luma:
    """Return ``image`` (H, W) aligned with ``scene``; where it has nothing, that of ``scene``."""
    height, width = scene.shape
    half = max(height, width) / 2
    pixels = np.array([[half, 0, (width - 1) / 2], [0, half, (height - 1) / 2], [0, 0, 1]])
    return cv2.warpAffine(
        image,
        (pixels @ by @ np.linalg.inv(pixels))[:2],
        (width, height),
        scene.copy(),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_TRANSPARENT,
    )


def length(by: Map, shape: tuple[int, ...]) -> float:
    """Return how far (pixels) a map moves the middle of an image of ``shape``."""
    return hypot(by[0, 2], by[1, 2]) * max(shape) / 2


def _slopes(scene: Luma, terms: int, every: int) -> npt.NDArray[np.float32]:
    """Return how each pixel of ``scene`` changes with each term of a map, (terms, pixels).

    terms: 2 for a shift, 6 for an affine map. Rows are used in steps of ``every``.
    """
    rows, columns = slice(1, -1, every), slice(1, -1)
    height, width = scene.shape
    longer = np.float32(max(height, width))
    dx = scene[rows, 2:].astype(np.float32) - scene[rows, :-2]
    dy = scene[2::every, columns][: len(dx)].astype(np.float32)
    dy -= scene[:-2:every, columns][: len(dx)]
    slopes = [dx, dy]
    if terms > len(slopes):
        x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)
        x = ((2 * x + 1 - width) / longer)[columns]
        y = ((2 * y + 1 - height) / longer)[rows, np.newaxis]
        slopes += [dx * x, dy * x, dx * y, dy * y]
    return np.stack(slopes).reshape(terms, -1) * (longer / 4)


def _step(
    image: Luma, scene: Luma, settled: Luma, table: npt.NDArray[np.float32], every: int
) -> Map:
    """Return the map that takes ``scene`` to ``image`` as far as a single step finds it.

    table: from `_slopes`, with the same ``every``.
    """
    # Differences of the pixels that show the settled scene.
    rows, columns = slice(1, -1, every), slice(1, -1)
    difference = scene[rows, columns].astype(np.float32) - image[rows, columns]
    good = (settled[rows, columns] != 0) & (np.abs(difference) < _OUTLIER)

    # Normal equations, damped where the scene has hardly any gradients.
    weighted = table * good.ravel()
    normal = (weighted @ table.T).astype(np.float64)
    normal += _DAMPING * np.trace(normal) / len(table) * np.eye(len(table))
    side = (weighted @ difference.reshape(-1, 1)).astype(np.float64)
    change = cv2.solve(normal, side, flags=cv2.DECOMP_SVD)[1]

    found = IDENTITY.copy()
    found[:2, (2, 0, 1)[: len(table) // 2]] += change.reshape(-1, 2).T
    return found
