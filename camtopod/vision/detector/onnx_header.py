"""Size of the image that an ONNX model takes, read from its file.

OpenCV does not say it. An ONNX file is a message of Protocol Buffers; this reads the few fields
that are needed and steps over the others. The numbers of the fields are those of `onnx.proto`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from camtopod.vision.detector.errors import DetectorError

SIZE_UNKNOWN = 640
"""Width and height (pixels) at which a model is used that leaves its size open."""
SIZE_MAX = 2048
"""Largest width and height of a model's input, pixels."""
_GRAPH = 7
"""ModelProto.graph"""
_INITIALIZER, _INPUT = 5, 11
"""GraphProto.initializer, GraphProto.input"""
_TENSOR_NAME = 8
"""TensorProto.name"""
_VALUE_NAME, _VALUE_TYPE = 1, 2
"""ValueInfoProto.name, ValueInfoProto.type"""
_TENSOR_TYPE = 1
"""TypeProto.tensor_type"""
_SHAPE = 2
"""TypeProto.Tensor.shape"""
_DIM = 1
"""TensorShapeProto.dim"""
_DIM_VALUE = 1
"""TensorShapeProto.Dimension.dim_value"""


def input_size(path: str) -> tuple[int, int]:
    """Return width and height (pixels) of the image that the model of a file takes.

    Raises `DetectorError`.
    """
    try:
        shapes = input_shapes(Path(path).read_bytes())
    except OSError as error:
        raise DetectorError("model", f"cannot read {path}: {error.strerror}") from None
    except ValueError as error:
        raise DetectorError("model", f"{path} is not an ONNX model: {error}") from None
    images = [shape for shape in shapes if len(shape) == 4 and shape[1] in (0, 3)]
    if len(shapes) != 1 or len(images) != 1 or images[0][0] > 1:
        inputs = " and ".join(str(tuple(shape)) for shape in shapes) or "none"
        raise DetectorError(
            "model", f"{path} does not take one image (1, 3, height, width); its inputs: {inputs}"
        )
    height, width = (length or SIZE_UNKNOWN for length in images[0][2:])
    if max(width, height) > SIZE_MAX or width % 32 or height % 32:
        what = f"takes {width} x {height} pixels: multiples of 32 are needed, up to {SIZE_MAX}"
        raise DetectorError("model", f"{path} {what}")
    return width, height


def input_shapes(content: bytes) -> list[list[int]]:
    """Return the shape of each input of the model in ``content``; 0 where a length is left open.

    Raises `ValueError`.
    """
    try:
        graph = next(_messages(memoryview(content), _GRAPH), None)
        if graph is None:
            raise ValueError("it has no graph")
        # Models of old versions list their weights as inputs, too.
        weights = {_name(tensor, _TENSOR_NAME) for tensor in _messages(graph, _INITIALIZER)}
        return [
            _shape(value)
            for value in _messages(graph, _INPUT)
            if _name(value, _VALUE_NAME) not in weights
        ]
    except IndexError:
        raise ValueError("it ends early") from None


def _shape(value: memoryview) -> list[int]:
    """Return the shape in a ValueInfoProto."""
    return [
        next((n for number, n in _fields(dim) if number == _DIM_VALUE and isinstance(n, int)), 0)
        for kind in _messages(value, _VALUE_TYPE)
        for tensor in _messages(kind, _TENSOR_TYPE)
        for shape in _messages(tensor, _SHAPE)
        for dim in _messages(shape, _DIM)
    ]


def _name(message: memoryview, number: int) -> bytes:
    return next((bytes(text) for text in _messages(message, number)), b"")


def _messages(message: memoryview, number: int) -> Iterator[memoryview]:
    """Yield the fields of that number that hold bytes."""
    for found, content in _fields(message):
        if found == number and isinstance(content, memoryview):
            yield content


def _fields(message: memoryview) -> Iterator[tuple[int, memoryview | int]]:
    """Yield number and content of the fields of a message. Raises `ValueError`, `IndexError`."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        kind = key & 7
        if kind == 0:
            value, at = _varint(message, at)
            yield key >> 3, value
            continue
        if kind == 2:
            length, at = _varint(message, at)
        elif kind in (1, 5):
            length = 8 if kind == 1 else 4
        else:
            raise ValueError("it is not an ONNX file")
        if at + length > len(message):
            raise ValueError("it ends early, or is not an ONNX file")
        if kind == 2:
            yield key >> 3, message[at : at + length]
        at += length


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """Return a whole number of variable length, and where the next field begins."""
    value = 0
    for shift in range(0, 70, 7):
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if not byte & 0x80:
            return value, at
    raise ValueError("it is not an ONNX file")
