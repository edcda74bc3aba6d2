"""The optional detector of people, a model that the operator has put on this machine.

Motion chooses the crops for inference and dates entries and exits; the detector counts the people
in them. Reading order:

- `detector`: the step of the pipeline; decides when to run inference;
- `crops`: the parts of the image that are given to the model;
- `model`: the model on OpenCV's DNN, with `onnx_header` (size of its input), `layouts` (its outputs
  -> boxes) and `coco` (names of its classes);
- `agreement`: whether the detector is trusted at this camera;
- `fusion`: motion and detections -> the blobs that are tracked;
- `model_report`: describes a model for people (`camtopod check --probe`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.vision.detector.coco import LABELS
    from camtopod.vision.detector.detector import Detector, DetectorResult, InferenceModel
    from camtopod.vision.detector.fusion import TrackedBox
    from camtopod.vision.detector.model import Detection, DetectorError, Model
    from camtopod.vision.detector.model_report import ModelReport, try_model
    from camtopod.vision.detector.onnx_header import HeaderError, input_size

__all__ = [
    "LABELS",
    "Detection",
    "Detector",
    "DetectorError",
    "DetectorResult",
    "HeaderError",
    "InferenceModel",
    "Model",
    "ModelReport",
    "TrackedBox",
    "input_size",
    "try_model",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "LABELS": "coco",
        "Detection": "model",
        "Detector": "detector",
        "DetectorError": "model",
        "HeaderError": "onnx_header",
        "TrackedBox": "fusion",
        "InferenceModel": "detector",
        "Model": "model",
        "ModelReport": "model_report",
        "DetectorResult": "detector",
        "input_size": "onnx_header",
        "try_model": "model_report",
    },
)
