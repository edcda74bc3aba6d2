"""Models of each layout of outputs: recognised, decoded, and refused where they cannot be used.

Each test runs on each engine that is installed.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import TensorProto, helper, save
from onnx_models import Picture, draw_person, write_model

from camtopod.vision.boxes import Box
from camtopod.vision.detector import layouts
from camtopod.vision.detector.crops import whole
from camtopod.vision.detector.model import Detection, DetectorError, DetectorModel
from camtopod.vision.settings import DetectorSettings, Layout

PEOPLE = ((40, 30, 80, 130), (180, 60, 220, 170))
"""Boxes in a picture of 300 x 200 pixels."""
ALONE: tuple[Layout, ...] = ("end-to-end", "rt-detr")
"""Layouts whose test models find a single person."""


@pytest.fixture(params=["OpenCV", "onnxruntime"], autouse=True)
def engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    if request.param == "OpenCV":
        monkeypatch.setitem(sys.modules, "onnxruntime", None)  # as if it were not installed
    else:
        pytest.importorskip("onnxruntime", reason="needs onnxruntime (camtopod[detector])")
    return str(request.param)


def picture() -> Picture:
    made = np.full((200, 300, 3), 120, np.uint8)
    for box in PEOPLE:
        draw_person(made, box)
    return made


def settings(path: Path, **given: Any) -> DetectorSettings:
    return DetectorSettings(model=str(path), **given)


def found(model: DetectorModel) -> list[Detection]:
    return sorted(model.infer(picture(), whole((300, 200), model.size)))


def assert_near(box: Box, expected: tuple[int, int, int, int], pixels: float) -> None:
    assert box == pytest.approx(expected, abs=pixels)


# --- every layout ---------------------------------------------------------------------------------


@pytest.mark.parametrize("layout", layouts.LAYOUTS)
def test_a_layout_is_recognised_and_its_boxes_are_right(tmp_path: Path, layout: Layout) -> None:
    model = DetectorModel(settings(write_model(tmp_path / "m.onnx", layout)))

    assert model.form.layout == layout
    assert model.size == (160, 160)
    people = found(model)
    assert {one.label for one in people} == {"person"}
    assert min(one.score for one in people) > 0.9
    assert len(people) == (1 if layout in ALONE else 2)
    for one, expected in zip(people, PEOPLE, strict=False):
        assert_near(one.box, expected, 3.0)


def test_positions_may_be_pixels_where_the_layout_is_named(tmp_path: Path) -> None:
    path = write_model(tmp_path / "m.onnx", "yolox", decoded=True)
    with pytest.raises(DetectorError, match='they can be layout = "yolox"') as caught:
        DetectorModel(settings(path))

    assert caught.value.key == "model"
    people = found(DetectorModel(settings(path, layout="yolox")))
    assert len(people) == 2
    assert_near(people[0].box, PEOPLE[0], 3.0)


@pytest.mark.parametrize("exporter", ["RF-DETR", "D-FINE"])
@pytest.mark.parametrize("classes", [4, 80])
def test_what_exporters_of_rt_detr_write_is_recognised(
    tmp_path: Path, exporter: str, classes: int
) -> None:
    path = write_model(tmp_path / "m.onnx", "rt-detr", exporter=exporter, classes=classes)
    model = DetectorModel(settings(path, labels=(0,)))
    assert model.form.layout == "rt-detr"
    (one,) = found(model)
    assert one.score > 0.9
    assert_near(one.box, PEOPLE[0], 3.0)


def test_rf_detr_numbers_its_91_classes_as_coco_does(tmp_path: Path) -> None:
    path = write_model(tmp_path / "m.onnx", "rt-detr", exporter="RF-DETR", classes=91)
    assert found(DetectorModel(settings(path))) == [], "its person is class 1"
    assert len(found(DetectorModel(settings(path, labels=(0,))))) == 1


@pytest.mark.parametrize("shape", [(1,), (1, 3), (1, 3, 8, 8)])
def test_an_output_that_is_no_table_of_boxes_is_passed_over(shape: tuple[int, ...]) -> None:
    boxes, scores = np.full((1, 3, 4), 0.5, np.float32), np.full((1, 3, 91), 0.1, np.float32)
    scores[0, 1, 1] = 0.9
    outputs = {"masks": np.zeros(shape, np.float32), "dets": boxes, "labels": scores}
    form = layouts.recognise(outputs, (160, 160), "")
    detections = layouts.decode(outputs, form, (160, 160), [1], 0.5)
    assert detections.boxes.tolist() == [[40.0, 40.0, 120.0, 120.0]]


@pytest.mark.parametrize("exporter", ["", "D-FINE"])
def test_nodes_need_not_be_in_order(tmp_path: Path, exporter: str) -> None:
    plain = write_model(tmp_path / "m.onnx", "rt-detr", exporter=exporter)
    mixed = write_model(tmp_path / "mixed.onnx", "rt-detr", exporter=exporter, shuffled=True)
    assert found(DetectorModel(settings(mixed))) == found(DetectorModel(settings(plain))) != []


@pytest.mark.parametrize("shape", [[1, 1575, 85], [1, 1, 100, 7], [1, 100, 4]])
def test_other_outputs_are_refused_with_the_names_of_the_known(
    tmp_path: Path, shape: list[int]
) -> None:
    image = helper.make_tensor_value_info("i", TensorProto.FLOAT, [1, 3, 160, 160])
    out = helper.make_tensor_value_info("out", TensorProto.FLOAT, shape)
    table = helper.make_tensor("t", TensorProto.FLOAT, shape, np.full(shape, 9.0).ravel())
    nodes = [
        helper.make_node("ReduceMean", ["i"], ["mean"], keepdims=0),
        helper.make_node("Add", ["mean", "t"], ["out"]),
    ]
    graph = helper.make_graph(nodes, "g", [image], [out], [table])
    opset = [helper.make_opsetid("", 13)]
    save(helper.make_model(graph, opset_imports=opset), str(tmp_path / "m.onnx"))
    with pytest.raises(
        DetectorError, match="known are yolox, yolov8, end-to-end, rt-detr"
    ) as caught:
        DetectorModel(settings(tmp_path / "m.onnx"))
    assert str(tuple(shape)) in str(caught.value)


# --- labels ---------------------------------------------------------------------------------------


def test_labels_are_names_of_coco_or_numbers(tmp_path: Path) -> None:
    path = write_model(tmp_path / "m.onnx", "yolox")
    assert found(DetectorModel(settings(path, labels=("bicycle", 7)))) == []
    assert len(found(DetectorModel(settings(path, labels=(0,))))) == 2

    other = write_model(tmp_path / "other.onnx", "yolox", classes=5)
    assert len(found(DetectorModel(settings(other, labels=(0, 3))))) == 2
    for labels, words in ((("person",), "5 classes"), ((5,), "no class 5")):
        with pytest.raises(DetectorError, match=words) as caught:
            DetectorModel(settings(other, labels=labels))
        assert caught.value.key == "labels"


# --- files that cannot be used --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "not an ONNX.* no graph|not an ONNX.*No graph"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "not an ONNX"),
        (b"<!DOCTYPE html>\n<title>Not found</title>\n", "not an ONNX"),
        (b"\xff" * 100, "not an ONNX"),
        (bytes(range(256)), "not an ONNX"),
    ],
)
def test_a_file_that_is_no_model_is_refused(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "m.onnx"
    path.write_bytes(content)
    with pytest.raises(DetectorError, match=words) as caught:
        DetectorModel(settings(path))
    assert caught.value.key == "model"
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("shapes", "words"),
    [
        ([[1, 1, 160, 160]], "does not take one image"),
        ([[4, 3, 160, 160]], "does not take one image"),
        ([[1, 3, 160, 160], [1, 3]], r"its inputs: \(1, 3, 160, 160\) and \(1, 3\)"),
    ],
)
def test_other_inputs_are_refused(tmp_path: Path, shapes: list[list[int]], words: str) -> None:
    inputs = [
        helper.make_tensor_value_info(f"i{k}", TensorProto.FLOAT, shape)
        for k, shape in enumerate(shapes)
    ]
    out = helper.make_tensor_value_info("out", TensorProto.FLOAT, shapes[0])
    graph = helper.make_graph([helper.make_node("Relu", ["i0"], ["out"])], "g", inputs, [out])
    opset = [helper.make_opsetid("", 13)]
    save(helper.make_model(graph, opset_imports=opset, ir_version=8), str(tmp_path / "m.onnx"))
    with pytest.raises(DetectorError, match=words):
        DetectorModel(settings(tmp_path / "m.onnx"))
