"""What OpenCV does not say about an ONNX model, read from its file: its inputs, and their size.

An ONNX file is a message of Protocol Buffers; this reads the few fields that are needed and steps
over the others.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

from camtopod.vision.detector.errors import DetectorError
from camtopod.vision.detector.inputs import Inputs, recognise_inputs

Field = IntEnum(
    "Field",
    {
        "MODEL_GRAPH": 7,
        "GRAPH_NODE": 1,
        "GRAPH_INITIALIZER": 5,
        "GRAPH_INPUT": 11,
        "NODE_INPUT": 1,
        "NODE_OUTPUT": 2,
        "TENSOR_NAME": 8,
        "VALUE_NAME": 1,
        "VALUE_TYPE": 2,
        "TYPE_TENSOR": 1,
        "TENSOR_SHAPE": 2,
        "SHAPE_DIM": 1,
        "DIM_VALUE": 1,
    },
)
"""Numbers of the fields in ``onnx.proto``, by message and field."""


class Header(NamedTuple):
    """Inputs of a model, by its file."""

    inputs: Inputs
    in_order: bytes | None
    """The model with each node after those that it needs; None if the file has that order."""


def read_header(path: str) -> Header:
    """Return what the file of a model says. Raises `DetectorError`."""
    try:
        content = memoryview(Path(path).read_bytes())
        shapes = _shapes(content)
        in_order = _in_order(content)
    except (ValueError, IndexError) as error:
        fault = "it ends early" if isinstance(error, IndexError) else error
        raise DetectorError("model", f"{path} is not an ONNX model: {fault}") from None
    return Header(recognise_inputs(path, shapes), in_order)


def _shapes(content: memoryview) -> dict[str, list[int]]:
    """Return name and shape of each input of a model; 0 where a length is left open."""
    graph = next(_at(content, Field.MODEL_GRAPH), None)
    if graph is None:
        raise ValueError("it has no graph")
    # Models of old versions list their weights as inputs, too.
    weights = {*_names(graph, Field.GRAPH_INITIALIZER, Field.TENSOR_NAME)}
    shape = (Field.VALUE_TYPE, Field.TYPE_TENSOR, Field.TENSOR_SHAPE, Field.SHAPE_DIM)
    return {
        name: [
            next((_varint(number, 0)[0] for number in _at(dim, Field.DIM_VALUE)), 0)
            for dim in _at(value, *shape)
        ]
        for value in _at(graph, Field.GRAPH_INPUT)
        for name in _names(value, Field.VALUE_NAME)
        if name not in weights
    }


def _in_order(model: memoryview) -> bytes | None:
    """Return a model with its nodes in topological order; None if they are.

    OpenCV reads the nodes one after the other, and knows nothing of those that come later.
    """
    (graph,) = _at(model, Field.MODEL_GRAPH)
    nodes = [whole for number, _, whole in _fields(graph) if number == Field.GRAPH_NODE]
    producers = {
        name: k
        for k, node in enumerate(nodes)
        for name in _names(node, Field.GRAPH_NODE, Field.NODE_OUTPUT)
    }
    needs = {
        k: [
            producers[name]
            for name in _names(node, Field.GRAPH_NODE, Field.NODE_INPUT)
            if name in producers
        ]
        for k, node in enumerate(nodes)
    }
    if all(source < k for k, inputs in needs.items() for source in inputs):
        return None
    parts = [nodes[k] for k in TopologicalSorter(needs).static_order()]
    parts += [whole for number, _, whole in _fields(graph) if number != Field.GRAPH_NODE]
    in_order = memoryview(b"".join(parts))  # as long as before
    return b"".join(
        part
        for number, content, whole in _fields(model)
        for part in (
            whole[: len(whole) - len(content)],
            in_order if number == Field.MODEL_GRAPH else content,
        )
    )


# -- Protocol Buffers ------------------------------


def _names(message: memoryview, *path: Field) -> Iterator[str]:
    """Yield the texts at a path of fields."""
    return (bytes(name).decode(errors="replace") for name in _at(message, *path))


def _at(message: memoryview, *path: Field) -> Iterator[memoryview]:
    """Yield the contents at a path of fields, one message in another."""
    for number, content, _ in _fields(message):
        if number == path[0]:
            yield from _at(content, *path[1:]) if path[1:] else (content,)


def _fields(message: memoryview) -> Iterator[tuple[int, memoryview, memoryview]]:
    """Yield number, content and all bytes of each field. Raises `ValueError`, `IndexError`."""
    at = 0
    while at < len(message):
        begin = at
        key, at = _varint(message, at)
        kind = key & 7
        if kind == 2:
            length, at = _varint(message, at)
        elif kind == 0:
            length = _varint(message, at)[1] - at
        else:
            length = {1: 8, 5: 4}.get(kind, len(message))
        if at + length > len(message):
            raise ValueError("it ends early, or is not an ONNX file")
        yield key >> 3, message[at : at + length], message[begin : at + length]
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
