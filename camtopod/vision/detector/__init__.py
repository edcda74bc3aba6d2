"""The optional detector of people, a model that the operator has put on this machine.

Motion chooses the parts of the picture to look at and dates entries and exits; the detector counts
the people in them. Reading order:

- `looker`: the step of the pipeline; decides when to look;
- `crops`: the parts of the picture to look at;
- `model`: the model on OpenCV's DNN, with `onnx_header` (size of its input), `layouts` (its outputs
  -> boxes) and `coco` (names of its classes);
- `agreement`: whether the detector is trusted at this camera;
- `fusion`: motion and detections -> the blobs that are tracked;
- `once`: describes a model for people (`camtopod check --probe`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.vision.detector.coco import LABELS
    from camtopod.vision.detector.fusion import Known
    from camtopod.vision.detector.looker import Detector, Looks, Seen
    from camtopod.vision.detector.model import Detection, DetectorError, Model
    from camtopod.vision.detector.once import ModelReport, try_model
    from camtopod.vision.detector.onnx_header import HeaderError, input_size

__all__ = [
    "LABELS",
    "Detection",
    "Detector",
    "DetectorError",
    "HeaderError",
    "Known",
    "Looks",
    "Model",
    "ModelReport",
    "Seen",
    "input_size",
    "try_model",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "LABELS": "coco",
        "Detection": "model",
        "Detector": "looker",
        "DetectorError": "model",
        "HeaderError": "onnx_header",
        "Known": "fusion",
        "Looks": "looker",
        "Model": "model",
        "ModelReport": "once",
        "Seen": "looker",
        "input_size": "onnx_header",
        "try_model": "once",
    },
)
