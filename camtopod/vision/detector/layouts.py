"""Outputs of detectors -> boxes: the layouts in which exported models write them.

There is no standard, but the shapes differ. With C classes, an input of W x H pixels and
G = sum of (W / s) * (H / s) over the strides s = 8, 16, 32:

- ``yolox``: (1, G, 5 + C): x, y, width, height, objectness, classes; positions relative to the cell
  and in strides, sizes as logarithms (raw grid), or pixels (decoded). BGR, 0 to 255.
- ``yolov5``: (1, 3 G, 5 + C), decoded: pixels. RGB, 0 to 1. YOLOv6 and YOLOv7 alike, with G or 3 G.
- ``yolov8``: (1, 4 + C, G): x, y, width, height, classes; pixels. RGB, 0 to 1. Also YOLO 9 and 11.
- ``end-to-end``: (1, N, 6): left, top, right, bottom, score, class; pixels. RGB, 0 to 1. Without
  NMS: YOLOv10, YOLO26, exports with built-in NMS.
- ``ssd``: (1, 1, N, 7): image, class, score, left, top, right, bottom; fractions. BGR, 0 to 255.
- ``rt-detr``: (1, Q, 4) and (1, Q, C), or both in one (1, Q, 4 + C): middle, size (fractions) and
  scores or their logits. RGB, 0 to 1. Without NMS.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple, get_args

import cv2
import numpy as np
import numpy.typing as npt

from camtopod.vision.boxes import Size
from camtopod.vision.detector.errors import DetectorError
from camtopod.vision.settings import Layout

Array = npt.NDArray[np.float32]

LAYOUTS: tuple[Layout, ...] = get_args(Layout)
"""Values of the setting `layout`."""
STRIDES = (8, 16, 32)
"""Pixels of the input a cell of each of the three grids."""
IOU_MAX = 0.5
"""Largest IoU of two boxes of a class."""
CANDIDATES_MAX = 300
"""Boxes that take part in NMS, those of the highest scores."""
DECODED_PIXELS = 8.0
"""Median of the absolute positions above which a grid is decoded.

A raw one holds offsets from the cell, in strides: most are between -1 and 2.
"""


class Form(NamedTuple):
    """Layout of a model's outputs, and its input size."""

    layout: Layout
    classes: int | None
    """Number of classes; None if the outputs do not say."""
    raw: bool = False
    """Positions are relative to the cells of the grid."""
    logits: bool = False
    """Scores are logits."""

    @property
    def bgr(self) -> bool:
        """True if it takes blue, green, red from 0 to 255; else red, green, blue from 0 to 1."""
        return self.layout in ("yolox", "ssd")

    @property
    def from_one(self) -> bool:
        """True if classes have COCO's own numbers, from 1."""
        return self.layout == "ssd"


class Found(NamedTuple):
    """Boxes that a model has found."""

    boxes: Array
    """(N, 4): left, top, right, bottom in pixels of the input."""
    scores: Array
    """(N,): 0 to 1."""
    classes: npt.NDArray[np.int64]
    """(N,): numbers of classes."""


# -- which layout ------------------------------


def recognise(outputs: Sequence[Array], size: Size, asked: str) -> Form:
    """Return the form of a model's outputs.

    outputs: those for any image; their values tell what the shapes leave open.
    size (width, height): the model's input, pixels.
    asked: the layout that the settings name; "" to recognise it.

    Raises `DetectorError`, which names the values of `layout` that can be written, if the outputs
    are of no known layout, of several, or not of the one that was asked for.
    """
    forms = _possible(outputs, size)
    fitting = [form for form in forms if asked in ("", form.layout)]
    if len(fitting) == 1 or (fitting and asked):
        return fitting[0]

    # None fits, or several do.
    shapes = " and ".join(str(tuple(output.shape)) for output in outputs)
    key: Literal["layout", "model"] = "model"
    what = "do not tell their layout" if forms else "are of no known layout"
    if asked:
        key = "layout"
        what = f"are not of the layout {asked!r}"
    raise DetectorError(key, f"its outputs, {shapes}, {what}; {_can_be(forms)}")


def _can_be(forms: Sequence[Form]) -> str:
    """Return which layouts the outputs can have, in words."""
    names = [f'"{form.layout}"' for form in forms]
    if not names:
        return f"known are {', '.join(LAYOUTS)}"
    if len(names) == 1:
        return f"they can be {names[0]}"
    return f"write layout = {', '.join(names[:-1])} or {names[-1]}"


def _possible(outputs: Sequence[Array], size: Size) -> list[Form]:
    """Return the forms that the shapes and values of the outputs allow."""
    shapes = [output.shape for output in outputs]

    # Boxes and scores apart.
    if len(outputs) == 2 and all(len(shape) == 3 for shape in shapes):
        boxes, scores = _boxes_first(outputs)
        if boxes.shape[2] != 4 or boxes.shape[:2] != scores.shape[:2]:
            return []
        return [Form("rt-detr", scores.shape[2], logits=_are_logits(scores))]
    if len(outputs) != 1 or shapes[0][:1] != (1,):
        return []
    output = outputs[0]
    shape = shapes[0]
    if len(shape) == 4 and shape[1] == 1 and shape[3] == 7:
        return [Form("ssd", None)]
    if len(shape) != 3:
        return []

    # A grid: the number of cells of its three strides tells it.
    _, rows, columns = shape
    cells = sum((size[0] // stride) * (size[1] // stride) for stride in STRIDES)
    if columns == cells and rows > 4:
        return [Form("yolov8", rows - 4)]
    if rows == 3 * cells and columns > 5:
        return [Form("yolov5", columns - 5)]
    if rows == cells and columns > 5:
        grid = Form(
            "yolox", columns - 5, raw=not np.median(np.abs(output[0, :, :2])) > DECODED_PIXELS
        )
        if grid.raw:
            return [grid]
        return [grid, Form("yolov5", columns - 5)]

    # No grid: at most this number of boxes.
    if columns == 6:
        forms = [Form("end-to-end", None)]
        if _are_fractions(output[..., :4]):
            forms.append(Form("rt-detr", 2, logits=_are_logits(output[..., 4:])))
        return forms
    if 4 < columns < rows and _are_fractions(output[..., :4]):
        return [Form("rt-detr", columns - 4, logits=_are_logits(output[..., 4:]))]
    return []


def _boxes_first(outputs: Sequence[Array]) -> tuple[Array, Array]:
    """Return (boxes, scores) of two outputs; with four classes the first are the boxes."""
    first, second = outputs
    swapped = first.shape[2] != 4
    if first.shape[2] == 4 and second.shape[2] == 4:
        swapped = _are_fractions(second) and not _are_fractions(first)
    return (second, first) if swapped else (first, second)


def _are_logits(scores: Array) -> bool:
    return bool(scores.min() < 0.0 or scores.max() > 1.0)


def _are_fractions(boxes: Array) -> bool:
    """Return True if positions and sizes are fractions of the input, not pixels."""
    return bool(boxes.min() >= -0.5 and 0.0 < boxes.max() <= 1.5)


# -- decoding ------------------------------


def decode(
    outputs: Sequence[Array],
    form: Form,
    size: Size,
    wanted: Sequence[int],
    score_min: float,
) -> Found:
    """Return the boxes of the wanted classes.

    size (width, height): the model's input, pixels.
    wanted: numbers of classes.
    score_min: least score, 0 to 1.
    """
    width, height = size
    scale = np.array([width, height, width, height], np.float32)
    output = outputs[0]

    # Boxes that name their class.
    if form.layout == "ssd":
        rows = output[0, 0]
        return nms(_of_classes(rows[:, 3:7] * scale, rows[:, 2], rows[:, 1], wanted, score_min))
    if form.layout == "end-to-end":
        rows = output[0]
        return _of_classes(rows[:, :4], rows[:, 4], rows[:, 5], wanted, score_min)

    # Boxes with a score for each class.
    if form.layout == "rt-detr":
        both = _boxes_first(outputs) if len(outputs) == 2 else (output[..., :4], output[..., 4:])
        boxes = _corners(both[0][0] * scale)
        scores = both[1][0]
        if form.logits:
            scores = np.asarray(1.0 / (1.0 + np.exp(-np.clip(scores, -50.0, 50.0))), np.float32)
    elif form.layout == "yolov8":
        rows = output[0].T
        boxes = _corners(rows[:, :4])
        scores = rows[:, 4:]
    else:
        rows = output[0]
        places = rows[:, :4]
        if form.raw:
            places = _from_grid(places, size)
        boxes = _corners(places)
        scores = rows[:, 5:] * rows[:, 4:5]

    # The best of the wanted classes.
    numbers = np.array(wanted, np.int64)
    chosen = scores[:, numbers]
    best = chosen.argmax(axis=1)
    found = _above(boxes, chosen[np.arange(len(best)), best], numbers[best], score_min)
    if form.layout == "rt-detr":
        return found
    return nms(found)


def _of_classes(
    boxes: Array, scores: Array, classes: Array, wanted: Sequence[int], least: float
) -> Found:
    """Return the boxes of the wanted classes with at least a score."""
    numbers = classes.round().astype(np.int64)
    kept = np.isin(numbers, wanted)
    return _above(boxes[kept], scores[kept], numbers[kept], least)


def _above(boxes: Array, scores: Array, classes: npt.NDArray[np.int64], score_min: float) -> Found:
    """Return the boxes with at least a score, best first; a score that is no number counts as 0."""
    kept = np.flatnonzero((scores >= score_min) & np.isfinite(boxes).all(axis=1))
    order = kept[np.argsort(-scores[kept], kind="stable")][:CANDIDATES_MAX]
    return Found(boxes[order], scores[order], classes[order])


def nms(found: Found) -> Found:
    """Return the boxes without those that a better one of the same class overlaps (greedy NMS).

    found: best first.
    """
    corners = found.boxes.astype(float)
    places = np.concatenate([corners[:, :2], corners[:, 2:] - corners[:, :2]], axis=1)
    kept = cv2.dnn.NMSBoxesBatched(
        places.tolist(), found.scores.tolist(), found.classes.tolist(), 0.0, IOU_MAX
    )
    order = np.asarray(kept, int)
    return Found(found.boxes[order], found.scores[order], found.classes[order])


def _corners(places: Array) -> Array:
    """Return left, top, right, bottom of middles and sizes, both (N, 4)."""
    half = places[:, 2:] / 2
    return np.concatenate([places[:, :2] - half, places[:, :2] + half], axis=1)


def _from_grid(raw: Array, size: Size) -> Array:
    """Return middles and sizes (N, 4), pixels, of the raw values of a grid (N, 4)."""
    cells = []
    strides = []
    for stride in STRIDES:
        rows, columns = size[1] // stride, size[0] // stride
        x, y = np.meshgrid(np.arange(columns), np.arange(rows))
        cells.append(np.stack([x.ravel(), y.ravel()], axis=1))
        strides.append(np.full((rows * columns, 1), stride))
    stride_of = np.concatenate(strides).astype(np.float32)
    middles = (raw[:, :2] + np.concatenate(cells)) * stride_of
    return np.concatenate([middles, np.exp(np.minimum(raw[:, 2:], 10.0)) * stride_of], axis=1)
