"""Models of a few nodes that find people drawn in certain colours, in every layout of outputs.

A person is a rectangle whose colours say where in it a pixel is: red is full (and 0 along its edge,
so that people side by side are apart), green grows from 0 at
its top to 255 at its bottom, blue from 0 at its left to 255 at its right. From the colour and its
slope a convolution knows the rectangle's middle and size at any scale, so the whole way from the
picture to boxes can be tested: order of the colours, their range, padding, scale, layout.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from onnx import TensorProto, checker, helper, numpy_helper, save

from camtopod.vision.settings import Layout

Picture = npt.NDArray[np.uint8]
STRIDE = 8
BASE = 8
"""Pixels between the two places whose difference is the slope."""
CLASSES = 80
TARGET = "orig_target_sizes"
"""Second input of D-FINE's exporter: width and height in whose units the boxes are."""


def draw_person(picture: Picture, box: tuple[int, int, int, int]) -> None:
    """Draw a person into a picture (H, W, 3), blue, green, red; what is outside is cut off."""
    left, top, right, bottom = box
    height, width = picture.shape[:2]
    x, y = np.meshgrid(
        (np.arange(left, right) + 0.5 - left) / (right - left),
        (np.arange(top, bottom) + 0.5 - top) / (bottom - top),
    )
    cloth = np.stack([255 * x, 255 * y, np.full_like(x, 255)], axis=2).round().astype(np.uint8)
    cloth[:2, :, 2] = cloth[-2:, :, 2] = cloth[:, :2, 2] = cloth[:, -2:, 2] = 0
    rows = slice(max(top, 0), max(min(bottom, height), 0))
    columns = slice(max(left, 0), max(min(right, width), 0))
    if rows.stop <= rows.start or columns.stop <= columns.start:
        return
    picture[rows, columns] = cloth[
        rows.start - top : rows.stop - top, columns.start - left : columns.stop - left
    ]


class _Graph:
    """Nodes and constants, each named after its number."""

    def __init__(self) -> None:
        self.nodes: list[object] = []
        self.constants: list[object] = []

    def constant(self, value: npt.ArrayLike, dtype: type = np.float32) -> str:
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(value, dtype), name))
        return name

    def add(self, kind: str, *inputs: str, outputs: int = 1, **attributes: object) -> str:
        name = f"n{len(self.nodes)}"
        names = [name] + [f"{name}_{k}" for k in range(1, outputs)]
        self.nodes.append(helper.make_node(kind, list(inputs), names, **attributes))
        return name


def write_model(
    path: Path,
    layout: Layout,
    size: tuple[int, int] = (160, 160),
    *,
    decoded: bool = False,
    classes: int = CLASSES,
    blind: bool = False,
    open_size: bool = False,
    exporter: str = "",
    shuffled: bool = False,
    fails_above: int | None = None,
) -> Path:
    """Write a model with an input of ``size`` (width, height) that finds people, class 0.

    decoded: with "yolox", positions are pixels.
    blind: it finds nothing.
    open_size: the file leaves the size open.
    exporter: with "rt-detr", whose outputs and inputs it has: "RF-DETR" or "D-FINE".
    shuffled: nodes come before those that they need.
    fails_above: with "yolox", grey level from which on an image makes onnxruntime fail.
    """
    width, height = size
    graph = _Graph()
    image = "images"
    if exporter == "RF-DETR":
        deviation = np.array([0.229, 0.224, 0.225]).reshape(1, 3, 1, 1)
        mean = np.array([0.485, 0.456, 0.406]).reshape(1, 3, 1, 1)
        image = graph.add("Mul", image, graph.constant(deviation))
        image = graph.add("Add", image, graph.constant(mean))
    if fails_above is not None:
        # The first of one number, or one that is not there.
        excess = graph.add("Sub", "images", graph.constant(fails_above))
        is_bright = graph.add(
            "Ceil", graph.add("Clip", excess, graph.constant(0.0), graph.constant(1.0))
        )
        index = graph.add("Cast", graph.add("ReduceMax", is_bright), to=TensorProto.INT64)
        image = graph.add("Add", image, graph.add("Gather", graph.constant([0.0]), index))
    rows, score = _found(graph, size, layout == "yolox", blind, image)
    outputs = _HEADS[layout](graph, rows, score, size, decoded, classes)

    # The file.
    shape = [1, 3, "height" if open_size else height, "width" if open_size else width]
    inputs = [helper.make_tensor_value_info("images", TensorProto.FLOAT, shape)]
    lengths = {name: [None] * 3 for name in outputs}
    if exporter == "RF-DETR":
        lengths = {"labels": [None] * 3, "dets": [None] * 3}
        for name, made in zip(lengths, outputs, strict=True):
            graph.nodes.append(helper.make_node("Identity", [made], [name]))
    if exporter == "D-FINE":
        inputs.append(helper.make_tensor_value_info(TARGET, TensorProto.INT64, [1, 2]))
        lengths = _d_fine(graph, *outputs)
    if shuffled:
        graph.nodes.reverse()
    model = helper.make_model(
        helper.make_graph(
            graph.nodes,
            "people",
            inputs,
            [
                helper.make_tensor_value_info(
                    name,
                    TensorProto.INT64
                    if name == "labels" and exporter == "D-FINE"
                    else TensorProto.FLOAT,
                    dims,
                )
                for name, dims in lengths.items()
            ],
            graph.constants,
        ),
        opset_imports=[helper.make_opsetid("", 13)],
        ir_version=8,
    )
    if not shuffled:
        checker.check_model(model)
    save(model, str(path))
    return path


def _found(
    graph: _Graph, size: tuple[int, int], bgr: bool, blind: bool, image: str
) -> tuple[str, str]:
    """Return middles and sizes (1, N, 4), pixels, and scores (1, N, 1) of the cells of stride 8."""
    width, height = size
    red, green, blue = (2, 1, 0) if bgr else (0, 1, 2)
    scale = 1 / 255 if bgr else 1.0
    kernel = BASE + 1

    # Green and blue at the middle of each cell, and their slopes; red, the least around it.
    weights = np.zeros((4, 3, kernel, kernel), np.float32)
    middle = BASE // 2
    weights[0, green, middle, middle] = weights[1, blue, middle, middle] = scale
    weights[2, green, -1, middle], weights[2, green, 0, middle] = scale / BASE, -scale / BASE
    weights[3, blue, middle, -1], weights[3, blue, middle, 0] = scale / BASE, -scale / BASE
    grid = {"kernel_shape": [kernel, kernel], "strides": [STRIDE, STRIDE], "pads": [0, 0, 1, 1]}
    maps = graph.add("Conv", image, graph.constant(weights), **grid)
    reds = np.zeros((1, 3, 1, 1), np.float32)
    reds[0, red] = -scale
    negative = graph.add("Conv", image, graph.constant(reds), kernel_shape=[1, 1])
    least = graph.add("MaxPool", negative, **grid)

    # Red from 0.8 to 1 is a score from 0 to 1.
    sharp = graph.add("Mul", least, graph.constant(-5.0))
    raised = graph.add("Add", sharp, graph.constant(-4.0 if not blind else -40.0))
    score = graph.add("Clip", raised, graph.constant(0.0), graph.constant(0.999))

    # Rows of cells.
    cells = (width // STRIDE) * (height // STRIDE)
    flat = graph.add("Reshape", maps, graph.constant([1, 4, cells], np.int64))
    table = graph.add("Transpose", flat, perm=[0, 2, 1])
    scores = graph.add("Reshape", score, graph.constant([1, cells, 1], np.int64))

    # Size: one over the slope. Middle: back from the cell by what the colour says.
    def column(k: int) -> str:
        ends = (graph.constant([k], np.int64), graph.constant([k + 1], np.int64))
        return graph.add("Slice", table, *ends, graph.constant([2], np.int64))

    x, y = np.meshgrid(np.arange(width // STRIDE), np.arange(height // STRIDE))
    places = [y.ravel(), x.ravel()]
    middles, sizes = [], []
    for k in (1, 0):
        slope = graph.add("Clip", column(2 + k), graph.constant(0.004), graph.constant(1.0))
        length = graph.add("Div", graph.constant(1.0), slope)
        back = graph.add("Sub", graph.constant(0.5), column(k))
        at = graph.constant((STRIDE * places[k] + middle + 0.5).reshape(1, -1, 1))
        middles.append(graph.add("Add", at, graph.add("Mul", back, length)))
        sizes.append(length)
    return graph.add("Concat", *middles, *sizes, axis=2), scores


def _yolox(
    graph: _Graph, rows: str, score: str, size: tuple[int, int], decoded: bool, classes: int
) -> list[str]:
    places = rows
    if not decoded:
        x, y = np.meshgrid(np.arange(size[0] // STRIDE), np.arange(size[1] // STRIDE))
        offsets = np.stack([x.ravel(), y.ravel(), 0 * x.ravel(), 0 * x.ravel()], 1)[None]
        parts = graph.add("Mul", rows, graph.constant(1 / STRIDE))
        middles = graph.add("Sub", parts, graph.constant(offsets))
        logs = graph.add("Log", graph.add("Clip", parts, graph.constant(0.01), graph.constant(1e4)))
        mask = graph.constant([[[1, 1, 0, 0]]])
        other = graph.constant([[[0, 0, 1, 1]]])
        places = graph.add("Add", graph.add("Mul", middles, mask), graph.add("Mul", logs, other))
    return [_padded(graph, [places, score, _class(graph, size, classes)], size)]


def _yolov8(
    graph: _Graph, rows: str, score: str, size: tuple[int, int], decoded: bool, classes: int
) -> list[str]:
    first = graph.constant(np.eye(1, classes)[None])
    table = _padded(graph, [rows, graph.add("Mul", score, first)], size)
    return [graph.add("Transpose", table, perm=[0, 2, 1])]


def _end_to_end(
    graph: _Graph, rows: str, score: str, size: tuple[int, int], decoded: bool, classes: int
) -> list[str]:
    best, its = _best(graph, rows, score)
    zero = graph.add("Mul", its, graph.constant(0.0))
    table = graph.add("Concat", _corners(graph, best), its, zero, axis=2)
    return [graph.add("Pad", table, graph.constant([0, 0, 0, 0, 9, 0], np.int64))]


def _rt_detr(
    graph: _Graph, rows: str, score: str, size: tuple[int, int], decoded: bool, classes: int
) -> list[str]:
    best, its = _best(graph, rows, score)
    boxes = graph.add("Div", best, graph.constant([[[*size, *size]]]))
    logit = graph.add("Mul", graph.add("Sub", its, graph.constant(0.5)), graph.constant(20.0))
    first = graph.constant(np.eye(1, classes)[None])
    others = graph.constant(-10.0 * (1 - np.eye(1, classes)[None]))
    logits = graph.add("Add", graph.add("Mul", logit, first), others)
    return [logits, graph.add("Clip", boxes, graph.constant(0.0), graph.constant(1.0))]


def _d_fine(graph: _Graph, logits: str, places: str) -> dict[str, list[int | None]]:
    """Add what the exporters of RT-DETR and D-FINE add, and return names and shapes of outputs."""
    scores = graph.add("Sigmoid", logits)
    graph.nodes.append(helper.make_node("ReduceMax", [scores], ["scores"], axes=[2], keepdims=0))
    graph.nodes.append(helper.make_node("ArgMax", [scores], ["labels"], axis=2, keepdims=0))
    sizes = graph.add("Cast", TARGET, to=TensorProto.FLOAT)
    scale = graph.add("Concat", sizes, sizes, axis=1)
    graph.nodes.append(helper.make_node("Mul", [_corners(graph, places), scale], ["boxes"]))
    return {"labels": [None] * 2, "boxes": [None] * 3, "scores": [None] * 2}


_HEADS = {
    "yolox": _yolox,
    "yolov8": _yolov8,
    "end-to-end": _end_to_end,
    "rt-detr": _rt_detr,
}


def _class(graph: _Graph, size: tuple[int, int], classes: int) -> str:
    """Return the score of each class (1, N, classes): 1 of the first, 0 of the others."""
    cells = (size[0] // STRIDE) * (size[1] // STRIDE)
    return graph.constant(np.broadcast_to(np.eye(1, classes)[None], (1, cells, classes)))


def _padded(graph: _Graph, columns: list[str], size: tuple[int, int], times: int = 1) -> str:
    """Return the columns side by side, with zeros for the cells of strides 16 and 32 below."""
    cells = [(size[0] // s) * (size[1] // s) for s in (8, 16, 32)]
    table = graph.add("Concat", *columns, axis=2)
    below = times * sum(cells) - cells[0]
    return graph.add("Pad", table, graph.constant([0, 0, 0, 0, below, 0], np.int64))


def _best(graph: _Graph, rows: str, score: str) -> tuple[str, str]:
    """Return the box (1, 1, 4) and the score (1, 1, 1) of the best cell."""
    flat = graph.add("Reshape", score, graph.constant([1, -1], np.int64))
    its = graph.add("TopK", flat, graph.constant([1], np.int64), outputs=2, axis=1)
    index = graph.add("Reshape", f"{its}_1", graph.constant([1], np.int64))
    best = graph.add("Gather", rows, index, axis=1)
    return best, graph.add("Reshape", its, graph.constant([1, 1, 1], np.int64))


def _corners(graph: _Graph, rows: str) -> str:
    """Return left, top, right, bottom of middles and sizes (1, N, 4)."""
    matrix = np.array([[1, 0, 1, 0], [0, 1, 0, 1], [-0.5, 0, 0.5, 0], [0, -0.5, 0, 0.5]])
    return graph.add("MatMul", rows, graph.constant(matrix))
