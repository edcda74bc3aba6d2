"""A detector's model: crop of an image -> boxes of the wanted labels."""

from __future__ import annotations

import time
from pathlib import Path
from typing import NamedTuple, cast

import cv2
import numpy as np
from msgspec import Struct

from camtopod.vision.boxes import Box, Size
from camtopod.vision.detector import layouts
from camtopod.vision.detector.coco import class_number, label_name
from camtopod.vision.detector.crops import whole
from camtopod.vision.detector.engines import load_engine
from camtopod.vision.detector.errors import DetectorError as DetectorError
from camtopod.vision.settings import DetectorSettings

Image = cv2.typing.MatLike
"""Colour image (H, W, 3), uint8: blue, green, red."""

PADDING = 114
"""Grey level beside an image that does not fill the model's input, as in training."""
KNOWN_SCORE_SHARE = 0.375
"""Share of the setting `score` that is enough where something is tracked already."""
IMAGENET_MEAN = np.array([0.485, 0.456, 0.406], np.float32).reshape(1, 3, 1, 1)
"""Mean of red, green and blue (0 to 1) in ImageNet."""
IMAGENET_DEVIATION = np.array([0.229, 0.224, 0.225], np.float32).reshape(1, 3, 1, 1)
"""Their standard deviation."""


class Detection(NamedTuple):
    """An object that a model has found."""

    box: Box
    """Left, top, right, bottom in pixels; right and bottom are exclusive."""
    score: float
    """0 to 1."""
    label: str
    """Name of its class, or the number of a class without a name."""


class ModelReport(Struct, frozen=True):
    """What a model is, or why it cannot be used."""

    problem: str = ""
    """Why it cannot be used; "" if it can."""
    key: str = "model"
    """The setting of ``[detector]`` that is to be changed then."""
    text: str = ""
    """Layout, size, milliseconds and boxes, in words."""


class DetectorModel:
    """A loaded model. For a single thread.

    size (width, height): its input, pixels.
    form: layout and number of classes of its outputs.
    """

    def __init__(self, settings: DetectorSettings) -> None:
        """Load the model and run it on an empty image. Raises `DetectorError`."""
        self.name = Path(settings.model).name
        self._engine = load_engine(settings.model)
        self.size = self._engine.size

        # Run it once: the outputs tell the layout.
        empty = np.full((self.size[1], self.size[0], 3), PADDING, np.uint8)
        outputs = self._engine.run(cv2.dnn.blobFromImage(empty))
        self.form = layouts.recognise(outputs, self.size, settings.layout)

        # The classes that are looked for.
        self._classes = [class_number(label, self.form.classes) for label in settings.labels]
        self._score_min = KNOWN_SCORE_SHARE * settings.score

    def infer(self, image: Image, crop: Box) -> list[Detection]:
        """Return the detections in a crop of an image (H, W, 3), boxes in pixels of the image.

        crop: of the shape of the input; what of it is outside of the image is filled with grey.

        Scores are from `KNOWN_SCORE_SHARE` of the setting `score` on. Raises `DetectorError` if
        the model can be run no longer.
        """
        canvas = _cropped(image, crop, self.size)
        if self.form.layout == "yolox":
            blob = cv2.dnn.blobFromImage(canvas)
        else:
            blob = cv2.dnn.blobFromImage(canvas, 1.0 / 255.0, swapRB=True)
        if self.form.imagenet:
            blob = (blob - IMAGENET_MEAN) / IMAGENET_DEVIATION
        outputs = self._engine.run(blob)
        detections = layouts.decode(outputs, self.form, self.size, self._classes, self._score_min)

        # From pixels of the input to pixels of the image.
        factor = self.size[0] / (crop[2] - crop[0])
        rows, columns = image.shape[:2]
        boxes = detections.boxes / factor + (crop[0], crop[1], crop[0], crop[1])
        boxes = np.clip(boxes, 0.0, (columns, rows, columns, rows))
        return [
            Detection(
                cast(Box, tuple(map(float, box))),
                float(score),
                label_name(int(number), self.form.classes),
            )
            for box, score, number in zip(boxes, detections.scores, detections.classes, strict=True)
            if box[2] - box[0] >= 1.0 and box[3] - box[1] >= 1.0
        ]

    @property
    def engine(self) -> str:
        """Name of the engine that runs it, with its provider if it has a choice of them."""
        return self._engine.name


def try_model(settings: DetectorSettings, image: Image | None = None) -> ModelReport:
    """Load the model of the settings, run it on an image, and describe it.

    image (H, W, 3): blue, green, red; None for an empty one.
    """
    try:
        model = DetectorModel(settings)
        width, height = model.size
        frame: Image = np.full((height, width, 3), PADDING, np.uint8) if image is None else image

        # The whole image. The first time takes longer.
        crop = whole((frame.shape[1], frame.shape[0]), model.size)
        model.infer(frame, crop)
        start = time.perf_counter()
        detections = model.infer(frame, crop)
        milliseconds = 1e3 * (time.perf_counter() - start)
    except DetectorError as error:
        return ModelReport(str(error), error.key)
    detections = [detection for detection in detections if detection.score >= settings.score]

    # Describe it.
    classes = model.form.classes
    kinds = {None: "", 1: ", 1 class"}.get(classes, f", {classes} classes")
    boxes = [
        f"{detection.label} {detection.score:.2f} at ({detection.box[0] / frame.shape[1]:.2f}, "
        f"{detection.box[1] / frame.shape[0]:.2f}) to ({detection.box[2] / frame.shape[1]:.2f}, "
        f"{detection.box[3] / frame.shape[0]:.2f})"
        for detection in detections
    ]
    place = "an empty image" if image is None else "the whole image"
    return ModelReport(
        text=f"{model.name}: layout {model.form.layout}, {width}x{height}{kinds}, "
        f"{milliseconds:.0f} ms an inference on {model.engine}; "
        f"in {place}: {', '.join(boxes) or 'nothing'}"
    )


def _cropped(image: Image, crop: Box, size: Size) -> Image:
    """Return a crop at ``size`` (width, height), grey where it is outside."""
    rows, columns = image.shape[:2]
    left, top, right, bottom = (round(side) for side in crop)
    inside = image[max(0, top) : bottom, max(0, left) : right]
    beside = (max(0, -top), max(0, bottom - rows), max(0, -left), max(0, right - columns))
    canvas = cv2.copyMakeBorder(inside, *beside, cv2.BORDER_CONSTANT, value=(PADDING,) * 3)
    way = cv2.INTER_AREA if canvas.shape[1] > size[0] else cv2.INTER_LINEAR
    return cv2.resize(canvas, size, interpolation=way)
