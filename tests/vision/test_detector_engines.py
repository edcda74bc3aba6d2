"""Engines of a detector: the same boxes, and providers that fail."""

from __future__ import annotations

import logging
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from onnx_models import Picture, draw_person, write_model

from camtopod.vision.detector import layouts
from camtopod.vision.detector.crops import whole
from camtopod.vision.detector.detector import Detector
from camtopod.vision.detector.model import DetectorError, DetectorModel, try_model
from camtopod.vision.settings import DetectorSettings

EXPORTS = [
    *((layout, "") for layout in layouts.LAYOUTS),
    ("rt-detr", "RF-DETR"),
    ("rt-detr", "D-FINE"),
]


def picture() -> Picture:
    made = np.full((200, 300, 3), 120, np.uint8)
    for box in ((40, 30, 80, 130), (180, 60, 220, 170)):
        draw_person(made, box)
    return made


@pytest.mark.parametrize(("layout", "exporter"), EXPORTS)
def test_both_engines_give_the_same_boxes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, layout: Any, exporter: str
) -> None:
    pytest.importorskip("onnxruntime", reason="needs onnxruntime (camtopod[detector])")
    path = write_model(tmp_path / "m.onnx", layout, exporter=exporter)
    settings = DetectorSettings(str(path), ("person", 0))
    models = [DetectorModel(settings)]
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    models.append(DetectorModel(settings))
    assert [model.engine for model in models] == ["onnxruntime (CPUExecutionProvider)", "OpenCV"]

    crops = [whole((300, 200), models[0].size), (20.0, 10.0, 150.0, 140.0)]
    for crop in crops:
        found, expected = (model.infer(picture(), crop) for model in models)
        assert [one.label for one in found] == [one.label for one in expected] != []
        for one, other in zip(found, expected, strict=True):
            assert one.box == pytest.approx(other.box, abs=0.5)
            assert one.score == pytest.approx(other.score, abs=0.01)


# --- providers ------------------------------------------------------------------------------------


class ProviderError(Exception):
    """As of onnxruntime, whose errors have no base of their own."""


class Session:
    """A session whose model finds nothing; CUDA lacks its library, OpenVINO fails when run."""

    opened: list[list[str]]
    broken: set[str]

    def __init__(
        self, path: str, options: Any, *, providers: list[str], enable_fallback: bool
    ) -> None:
        assert not enable_fallback, "it prints, and knows only CUDA and the processor"
        self.opened.append(list(providers))
        if "load" in self.broken and providers == ["CPUExecutionProvider"]:
            raise ProviderError(
                f"[ONNXRuntimeError] : 7 : INVALID_PROTOBUF : Load model from {path} failed:Protobuf parsing failed."
            )
        self._providers = [name for name in providers if name != "CUDAExecutionProvider"]

    def get_providers(self) -> list[str]:
        return self._providers

    def get_inputs(self) -> list[SimpleNamespace]:
        return [
            SimpleNamespace(name="images", shape=["batch", 3, 160, None], type="tensor(float16)")
        ]

    def get_outputs(self) -> list[SimpleNamespace]:
        return [SimpleNamespace(name="output")]

    def run(self, names: list[str], feed: dict[str, Any]) -> list[Any]:
        assert feed["images"].dtype == np.float16
        assert feed["images"].shape == (1, 3, 160, 640), "an open length is 640"
        if self._providers[0] in self.broken:
            raise ProviderError("[ONNXRuntimeError] : 11 : EP_FAIL : device\nlost")
        return [np.zeros((1, 2100, 85), np.float16)]


@pytest.fixture
def session(monkeypatch: pytest.MonkeyPatch) -> type[Session]:
    """Sessions of an onnxruntime with many providers."""
    kinds = ("Tensorrt", "CUDA", "OpenVINO", "Azure", "CPU")
    made = type("Opened", (Session,), {"opened": [], "broken": set()})
    fake = SimpleNamespace(
        InferenceSession=made,
        SessionOptions=SimpleNamespace,
        get_available_providers=lambda: [f"{kind}ExecutionProvider" for kind in kinds],
        capi=SimpleNamespace(onnxruntime_pybind11_state=SimpleNamespace(EPFail=ProviderError)),
    )
    monkeypatch.setitem(sys.modules, "onnxruntime", fake)
    return made


@pytest.fixture
def settings(tmp_path: Path) -> DetectorSettings:
    (tmp_path / "m.onnx").touch()
    return DetectorSettings(str(tmp_path / "m.onnx"))


def test_a_provider_that_fails_is_left_for_the_next_with_a_warning(
    session: type[Session], settings: DetectorSettings, caplog: pytest.LogCaptureFixture
) -> None:
    model = DetectorModel(settings)
    detector = Detector(model, settings)
    words = "CUDAExecutionProvider of onnxruntime fails (it cannot be loaded); OpenVINO"
    assert words in caplog.text
    assert detector.statistics()["detector_engine"] == "onnxruntime (OpenVINOExecutionProvider)"

    caplog.clear()
    session.broken.add("OpenVINOExecutionProvider")
    for _ in range(3):
        assert model.infer(picture(), (0.0, 0.0, 300.0, 75.0)) == []
    [record] = caplog.records
    assert record.levelno == logging.WARNING
    assert "OpenVINOExecutionProvider of onnxruntime fails (device lost); CPU" in record.message
    assert detector.statistics()["detector_engine"] == "onnxruntime (CPUExecutionProvider)"
    assert session.opened == [
        ["CUDAExecutionProvider", "OpenVINOExecutionProvider", "CPUExecutionProvider"],
        ["CPUExecutionProvider"],
    ]

    session.broken.add("CPUExecutionProvider")
    words = re.escape(f"{settings.model} can be run by onnxruntime no longer: device lost")
    with pytest.raises(DetectorError, match=words):
        model.infer(picture(), (0.0, 0.0, 300.0, 75.0))


def test_a_report_names_the_engine_and_why_no_provider_can_load_a_model(
    session: type[Session], settings: DetectorSettings
) -> None:
    assert (
        "ms an inference on onnxruntime (OpenVINOExecutionProvider); " in try_model(settings).text
    )
    session.broken |= {"load", "OpenVINOExecutionProvider"}
    report = try_model(settings)
    assert report.key == "model"
    assert report.problem == (
        f"{settings.model} is not an ONNX model that onnxruntime can run: Protobuf parsing failed"
    )
