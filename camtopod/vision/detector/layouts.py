"""Outputs of detectors -> boxes: the layouts in which exported models write them.

There is no standard, but the shapes differ. With C classes, an input of W x H pixels and
G = sum of (W / s) * (H / s) over the strides s = 8, 16, 32:

- ``yolox``: (1, G, 5 + C): x, y, width, height, objectness, classes; positions relative to the cell
  and in strides, sizes as logarithms (raw grid), or pixels (decoded). BGR, 0 to 255.
- ``yolov8``: (1, 4 + C, G): x, y, width, height, classes; pixels. RGB, 0 to 1. Also YOLO 9 to 12.
- ``end-to-end``: (1, N, 6): left, top, right, bottom, score, class; pixels. RGB, 0 to 1. Without
  NMS: YOLO26, YOLOv10, exports with built-in NMS.
- ``rt-detr``: without NMS. RGB, 0 to 1. One of

  - boxes (1, Q, 4) and classes (1, Q, C), or both in one (1, Q, 4 + C): middle and size
    (fractions), scores or their logits; RF-DETR calls them ``dets`` and ``labels``, and takes RGB
    less the mean of ImageNet, over its standard deviation;
  - ``labels`` (1, Q), ``boxes`` (1, Q, 4), ``scores`` (1, Q): corners in units of a second input;
    so RT-DETR and D-FINE are exported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, get_args

import cv2
import numpy as np
import numpy.typing as npt

from camtopod.vision.boxes import OBJECTS_MAX, Size
from camtopod.vision.detector.errors import DetectorError
from camtopod.vision.settings import Layout

Array = npt.NDArray[np.float32]
Outputs = Mapping[str, Array]
"""Outputs of a model by name."""

LAYOUTS: tuple[Layout, ...] = get_args(Layout)
"""Values of the setting `layout`."""
STRIDES = (8, 16, 32)
"""Pixels of the input a cell of each of the three grids."""
IOU_MAX = 0.5
"""Largest IoU of two boxes of a class."""


class Form(NamedTuple):
    """Layout of a model's outputs."""

    layout: Layout
    classes: int | None
    """Number of classes; None if the outputs do not say."""
    certain: bool = True
    """False if other models, with another input, have such outputs, too."""
    imagenet: bool = False
    """Its input is normalised by the mean and standard deviation of ImageNet."""


class Found(NamedTuple):
    """Boxes that a model has found."""

    boxes: Array
    """(N, 4): left, top, right, bottom in pixels of the input."""
    scores: Array
    """(N,): 0 to 1."""
    classes: npt.NDArray[np.int64]
    """(N,): numbers of classes."""


# -- which layout ------------------------------


def recognise(outputs: Outputs, size: Size, layout: str) -> Form:
    """Return the form of a model's outputs.

    outputs: those for any image; their values tell what the shapes leave open.
    size (width, height): the model's input, pixels.
    layout: the layout that the settings name; "" to recognise it.

    Raises `DetectorError`, which names the values of `layout` that can be written, if the outputs
    are of no known layout, uncertain, or not of the one that was asked for.
    """
    forms = _possible(outputs, size)
    for form in forms:
        if form.layout == layout or (form.certain and not layout):
            return form

    shapes = " and ".join(str(output.shape) for output in outputs.values())
    fault = f"are not of the layout {layout!r}" if layout else "do not tell their layout"
    can_be = " or ".join(f'layout = "{form.layout}"' for form in forms)
    choices = f"known are {', '.join(LAYOUTS)}"
    raise DetectorError(
        "layout" if layout else "model",
        f"its outputs, {shapes}, {fault}; {f'they can be {can_be}' if can_be else choices}",
    )


def _possible(outputs: Outputs, size: Size) -> list[Form]:
    """Return the forms that the shapes and values of the outputs allow."""
    if {"labels", "boxes", "scores"} <= set(outputs):
        return [Form("rt-detr", None)]
    tables = _tables(outputs)
    if len(tables) > 1:
        boxes, scores = _boxes_and_scores(tables)
        if boxes.shape[2] != 4 or boxes.shape[1] != scores.shape[1]:
            return []
        return [Form("rt-detr", scores.shape[2], imagenet="dets" in tables)]
    if len(tables) != 1 or len(outputs) != 1:
        return []

    # A grid: the number of cells of its three strides tells it.
    (output,) = tables.values()
    _, rows, columns = output.shape
    cells = sum((size[0] // stride) * (size[1] // stride) for stride in STRIDES)
    if columns == cells and rows > 4:
        return [Form("yolov8", rows - 4)]
    if rows == cells and columns > 5:
        return [Form("yolox", columns - 5, certain=_is_raw(output[0]))]

    # No grid.
    forms = [Form("end-to-end", None)] if columns == 6 else []
    if columns > 4 and _are_fractions(output[..., :4]):
        forms.append(Form("rt-detr", columns - 4, certain=columns != 6))
    return forms


def _tables(outputs: Outputs) -> Outputs:
    """Return the outputs with a row for each box; others may be masks, or the number of boxes."""
    return {name: output for name, output in outputs.items() if output.ndim == 3}


def _boxes_and_scores(tables: Outputs) -> tuple[Array, Array]:
    """Return boxes (1, Q, 4) and scores (1, Q, C) of two outputs; the names tell if C is 4."""
    box_names = [name for name in tables if "box" in name or name == "dets"]
    names = sorted(tables, key=lambda name: (tables[name].shape[2] != 4, name not in box_names))
    return tables[names[0]], tables[names[1]]


def _is_raw(rows: Array) -> bool:
    """Return True if the positions are offsets from a cell in strides, mostly from -1 to 2."""
    return bool(np.median(np.abs(rows[:, :2])) < STRIDES[0])


def _are_fractions(boxes: Array) -> bool:
    """Return True if positions and sizes are fractions of the input, not pixels."""
    return bool(boxes.min() >= -0.5 and 0.0 < boxes.max() <= 1.5)


# -- decoding ------------------------------


def decode(
    outputs: Outputs, form: Form, size: Size, classes: Sequence[int], score_min: float
) -> Found:
    """Return the boxes of the wanted classes, best first.

    size (width, height): the model's input, pixels.
    classes: numbers of classes.
    score_min: least score, 0 to 1; a score that is no number counts as 0.
    """
    (first, *_) = outputs.values()
    with np.errstate(over="ignore"):  # what is infinite then is dropped below
        if form.layout == "yolox":
            detections = _yolox(first[0], size, classes)
        elif form.layout == "yolov8":
            detections = _yolov8(first[0], classes)
        elif form.layout == "end-to-end":
            detections = _end_to_end(first[0])
        else:
            detections = _rt_detr(outputs, size, classes)

    mask = np.isin(detections.classes, classes) & (detections.scores >= score_min)
    indices = np.flatnonzero(mask & np.isfinite(detections.boxes).all(axis=1))
    indices = indices[np.argsort(-detections.scores[indices], kind="stable")][:OBJECTS_MAX]
    detections = _taken(detections, indices)
    return nms(detections) if form.layout in ("yolox", "yolov8") else detections


def _yolox(rows: Array, size: Size, classes: Sequence[int]) -> Found:
    places = _from_grid(rows[:, :4], size) if _is_raw(rows) else rows[:, :4]
    return _best(_corners(places), rows[:, 5:] * rows[:, 4:5], classes)


def _yolov8(columns: Array, classes: Sequence[int]) -> Found:
    return _best(_corners(columns[:4].T), columns[4:].T, classes)


def _end_to_end(rows: Array) -> Found:
    return Found(rows[:, :4], rows[:, 4], rows[:, 5].round().astype(np.int64))


def _rt_detr(outputs: Outputs, size: Size, classes: Sequence[int]) -> Found:
    if "scores" in outputs:
        labels = outputs["labels"][0].astype(np.int64)
        return Found(outputs["boxes"][0], outputs["scores"][0], labels)
    (first, *other_tables) = _tables(outputs).values()
    boxes, scores = first[..., :4], first[..., 4:]
    if other_tables:
        boxes, scores = _boxes_and_scores(_tables(outputs))
    if scores.min() < 0.0 or scores.max() > 1.0:  # logits
        scores = np.asarray(1.0 / (1.0 + np.exp(-scores)), np.float32)
    return _best(_corners(boxes[0] * np.array(size * 2, np.float32)), scores[0], classes)


def _best(boxes: Array, scores: Array, classes: Sequence[int]) -> Found:
    """Return the boxes (N, 4), each as the best of the wanted classes; scores (N, classes)."""
    numbers = np.array(classes, np.int64)
    class_scores = scores[:, numbers]
    best = class_scores.argmax(axis=1)
    return Found(boxes, class_scores[np.arange(len(best)), best], numbers[best])


def nms(detections: Found) -> Found:
    """Return the boxes without those that a better one of the same class overlaps (greedy NMS).

    detections: best first.
    """
    corners = detections.boxes.astype(float)
    places = np.concatenate([corners[:, :2], corners[:, 2:] - corners[:, :2]], axis=1)
    rows = cv2.dnn.NMSBoxesBatched(
        places.tolist(), detections.scores.tolist(), detections.classes.tolist(), 0.0, IOU_MAX
    )
    return _taken(detections, np.asarray(rows, np.int64))


def _taken(detections: Found, indices: npt.NDArray[np.int64]) -> Found:
    return Found(detections.boxes[indices], detections.scores[indices], detections.classes[indices])


def _corners(places: Array) -> Array:
    """Return left, top, right, bottom of middles and sizes, both (N, 4)."""
    half = places[:, 2:] / 2
    return np.concatenate([places[:, :2] - half, places[:, :2] + half], axis=1)


def _from_grid(raw: Array, size: Size) -> Array:
    """Return middles and sizes (N, 4), pixels, of the raw values of a grid (N, 4)."""
    cells = []
    for stride in STRIDES:
        x, y = np.meshgrid(np.arange(size[0] // stride), np.arange(size[1] // stride))
        cells.append(np.stack([x.ravel(), y.ravel(), np.full(x.size, stride)], axis=1))
    table = np.concatenate(cells).astype(np.float32)
    stride_of = table[:, 2:]
    return np.concatenate(
        [(raw[:, :2] + table[:, :2]) * stride_of, np.exp(raw[:, 2:]) * stride_of], axis=1
    )
