"""Models of each layout of outputs: recognised, decoded, and refused where they cannot be used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import TensorProto, helper, save
from onnx_models import Picture, draw_person, write_model

from camtopod.vision.boxes import Box
from camtopod.vision.detector import layouts
from camtopod.vision.detector.crops import whole
from camtopod.vision.detector.model import Detection, DetectorError, Model
from camtopod.vision.detector.onnx_header import input_size
from camtopod.vision.settings import DetectorSettings, Layout

PEOPLE = ((40, 30, 80, 130), (180, 60, 220, 170))
"""Boxes in a picture of 300 x 200 pixels."""
ALONE: tuple[Layout, ...] = ("end-to-end", "rt-detr")
"""Layouts whose test models find a single person."""


def picture() -> Picture:
    made = np.full((200, 300, 3), 120, np.uint8)
    for box in PEOPLE:
        draw_person(made, box)
    return made


def settings(path: Path, **given: Any) -> DetectorSettings:
    return DetectorSettings(model=str(path), **given)


def found(model: Model) -> list[Detection]:
    return sorted(model.infer(picture(), whole((300, 200), model.size)))


def assert_near(box: Box, expected: tuple[int, int, int, int], pixels: float) -> None:
    assert box == pytest.approx(expected, abs=pixels)


# --- every layout ---------------------------------------------------------------------------------


@pytest.mark.parametrize("layout", layouts.LAYOUTS)
def test_a_layout_is_recognised_and_its_boxes_are_right(tmp_path: Path, layout: Layout) -> None:
    model = Model(settings(write_model(tmp_path / "m.onnx", layout)))

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
    with pytest.raises(DetectorError, match='write layout = "yolox" or "yolov5"') as caught:
        Model(settings(path))

    assert caught.value.key == "model"
    people = found(Model(settings(path, layout="yolox")))
    assert len(people) == 2
    assert_near(people[0].box, PEOPLE[0], 3.0)


# --- labels ---------------------------------------------------------------------------------------


def test_labels_are_names_of_coco_or_numbers(tmp_path: Path) -> None:
    path = write_model(tmp_path / "m.onnx", "yolox")
    assert found(Model(settings(path, labels=("bicycle", 7)))) == []
    assert len(found(Model(settings(path, labels=(0,))))) == 2

    other = write_model(tmp_path / "other.onnx", "yolox", classes=5)
    assert len(found(Model(settings(other, labels=(0, 3))))) == 2
    for labels, words in ((("person",), "5 classes"), ((5,), "no class 5")):
        with pytest.raises(DetectorError, match=words) as caught:
            Model(settings(other, labels=labels))
        assert caught.value.key == "labels"


# --- files that cannot be used --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "has no graph"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "not an ONNX"),
        (b"\xff" * 100, "not an ONNX"),
        (bytes(range(256)), "not an ONNX"),
    ],
)
def test_a_file_that_is_no_model_is_refused(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "m.onnx"
    path.write_bytes(content)
    with pytest.raises(DetectorError, match=words) as caught:
        Model(settings(path))
    assert caught.value.key == "model"


@pytest.mark.parametrize(
    ("shapes", "words"),
    [
        ([[1, 3, 100, 160]], "160 x 100 pixels: multiples of 32"),
        ([[1, 3, 4096, 4096]], "up to 2048"),
        ([[1, 1, 160, 160]], "does not take one image"),
        ([[4, 3, 160, 160]], "does not take one image"),
        ([[1, 3, 160, 160], [1, 2]], r"its inputs: \(1, 3, 160, 160\) and \(1, 2\)"),
    ],
)
def test_other_inputs_are_refused(tmp_path: Path, shapes: list[list[int]], words: str) -> None:
    inputs = [
        helper.make_tensor_value_info(f"i{k}", TensorProto.FLOAT, shape)
        for k, shape in enumerate(shapes)
    ]
    out = helper.make_tensor_value_info("out", TensorProto.FLOAT, shapes[0])
    graph = helper.make_graph([helper.make_node("Relu", ["i0"], ["out"])], "g", inputs, [out])
    save(helper.make_model(graph), str(tmp_path / "m.onnx"))
    with pytest.raises(DetectorError, match=words):
        input_size(str(tmp_path / "m.onnx"))
