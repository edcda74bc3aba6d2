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

from camtopod.vision.boxes import Box
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
_LINEAR_MAX = 0.065
"""Largest deviation of a map's linear part from the identity; a camera that sways has less."""
_SHIFT_MAX = 0.2
"""Largest shift of a map, in half widths of the image."""
_RESIDUAL_MAX = 0.9
"""Largest share of the residual without a map that may be left by one that is used."""
_DAMPING = 1e-3
"""Changes for which the scene has less than this share of its gradients are hardly made."""


def shift(image: Luma, scene: Luma, settled_mask: Luma) -> float:
    """Return by how many pixels ``image`` (H, W) is shifted against ``scene``, to about a pixel.

    settled_mask (H, W): 0 where the image does not show the scene.
    """
    stride = 2 * _FACTORS[0]
    return length(
        _step(image, scene, *_least_squares(scene, settled_mask, 2, stride), stride), scene.shape
    )


def aligning(image: Luma, scene: Luma, settled_mask: Luma, first: Map) -> Map:
    """Return the map that takes ``scene`` (H, W) to ``image``.

    settled_mask (H, W): 0 where the image does not show the scene.
    first: where to begin.

    The identity is the result if no map near it is better by a tenth, or if the way to the best one
    leads away from it: a car or a crowd that fills much of the image moves as a whole, too, but
    farther than a camera that sways.
    """
    first = first if _is_near(first) else IDENTITY
    for factor in _FACTORS:
        size = [max(3, side // factor) for side in reversed(scene.shape)]
        small, model, weight_mask = (
            cv2.resize(layer, size, interpolation=cv2.INTER_AREA)
            for layer in (image, scene, settled_mask)
        )
        equations = _least_squares(model, weight_mask, 6, 1)
        trial, least = first, float("inf")
        for _ in range(_STEPS_MAX):
            if not _is_near(trial):
                return IDENTITY
            aligned_image = warped(small, model, trial)
            residual = _residual(aligned_image, model, weight_mask)
            if residual >= least:
                break
            first, least = trial, residual
            trial = trial @ _step(aligned_image, model, *equations, 1)
    is_better = least < _RESIDUAL_MAX * _residual(small, model, weight_mask)
    return first if is_better else IDENTITY


def _is_near(trial: Map) -> bool:
    """Return True if a camera may sway by so much."""
    off = np.abs(trial - IDENTITY)
    return bool(off[:2, :2].max() <= _LINEAR_MAX and off[:2, 2].max() <= _SHIFT_MAX)


def _residual(image: Luma, scene: Luma, weight_mask: Luma) -> float:
    """Return the mean difference (grey levels) of the pixels without objects."""
    off = np.minimum(cv2.absdiff(image, scene), np.uint8(_OUTLIER))
    return float(cv2.mean(off, weight_mask)[0])


def view(scene: Luma, by: Map) -> Box:
    """Return the part (left, top, right, bottom) of ``scene`` that an image shows, pixels.

    Rows and columns count of which half is shown.
    by: the map from the scene to the image.
    """
    mask = warped(np.full_like(scene, 255), np.zeros_like(scene), by) != 0
    columns, rows = mask.mean(axis=0) > 0.5, mask.mean(axis=1) > 0.5
    return (
        float(columns.argmax()),
        float(rows.argmax()),
        float(len(columns) - columns[::-1].argmax()),
        float(len(rows) - rows[::-1].argmax()),
    )


def warped(image: Luma, scene: Luma, by: Map) -> Luma:
    """Return ``image`` (H, W) aligned with ``scene``; where it has nothing, that of ``scene``."""
    height, width = scene.shape
    middle = np.array([width - 1, height - 1]) / 2
    matrix = by[:2].copy()
    matrix[:, 2] = by[:2, 2] * max(height, width) / 2 + middle - by[:2, :2] @ middle
    return cv2.warpAffine(
        image,
        matrix,
        (width, height),
        scene.copy(),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_TRANSPARENT,
    )


def moved(box: Box, by: Map, shape: tuple[int, ...]) -> Box:
    """Return a box of the scene as an image of ``shape`` shows it, pixels; its turn is left out.

    by: the map from the scene to the image; with the inverse, a box of the image in the scene.
    """
    middle = np.array([shape[1], shape[0]]) / 2
    corners = np.array(box).reshape(2, 2)
    centre = by[:2, :2] @ (corners.mean(axis=0) - middle) + by[:2, 2] * max(shape) / 2 + middle
    half = np.diag(by)[:2] * (corners[1] - corners[0]) / 2
    left, top = (centre - half).tolist()
    right, bottom = (centre + half).tolist()
    return (left, top, right, bottom)


def length(by: Map, shape: tuple[int, ...]) -> float:
    """Return how far (pixels) a map moves the middle of an image of ``shape``."""
    return hypot(by[0, 2], by[1, 2]) * max(shape) / 2


def _least_squares(
    scene: Luma, settled_mask: Luma, terms: int, stride: int
) -> tuple[npt.NDArray[np.float32], cv2.typing.MatLike]:
    """Return how each pixel of ``scene`` changes with each term of a map, (terms, pixels), and the
    inverse of the normal equations.

    terms: 2 for a shift, 6 for an affine map. Rows are used in steps of ``stride``.
    """
    # How each pixel changes with each term; not at all where the scene is not settled.
    rows, columns = slice(1, -1, stride), slice(1, -1)
    height, width = scene.shape
    longer = np.float32(max(height, width))
    weight = (settled_mask[rows, columns] != 0) * (longer / 4)
    dx = scene[rows, 2:].astype(np.float32) - scene[rows, :-2]
    above, below = (scene[row::stride, columns][: len(dx)] for row in (0, 2))
    slopes = [dx * weight, (below.astype(np.float32) - above) * weight]
    if terms > len(slopes):
        x = (np.arange(1 - width, width, 2, dtype=np.float32) / longer)[columns]
        y = (np.arange(1 - height, height, 2, dtype=np.float32) / longer)[rows, np.newaxis]
        slopes += [slope * place for place in (x, y) for slope in slopes]
    table = np.stack(slopes).reshape(terms, -1)

    # Damped where the scene has hardly any gradients.
    normal = (table @ table.T).astype(np.float64)
    normal += _DAMPING * np.trace(normal) / terms * np.eye(terms)
    return table, cv2.invert(normal, flags=cv2.DECOMP_SVD)[1]


def _step(
    image: Luma,
    scene: Luma,
    table: npt.NDArray[np.float32],
    inverse: cv2.typing.MatLike,
    stride: int,
) -> Map:
    """Return the map that takes ``scene`` to ``image`` as far as a single step finds it.

    table, inverse: from `_least_squares`, with the same ``stride``.
    """
    rows, columns = slice(1, -1, stride), slice(1, -1)
    difference = scene[rows, columns].astype(np.float32) - image[rows, columns]
    change = inverse @ (table @ (difference * (np.abs(difference) < _OUTLIER)).ravel())
    result = IDENTITY.copy()
    result[:2, (2, 0, 1)[: len(change) // 2]] += change.reshape(-1, 2).T
    return result
