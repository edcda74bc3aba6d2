"""What a detector's model is, for people: loaded, and used once."""

from __future__ import annotations

import time

import numpy as np
from msgspec import Struct

from camtopod.vision.detector.crops import whole
from camtopod.vision.detector.model import PADDING, DetectorError, Image, Model
from camtopod.vision.settings import DetectorSettings

BOXES_MAX = 10
"""Boxes that are listed, those of the highest scores."""


class ModelReport(Struct, frozen=True):
    """What a model is, or why it cannot be used."""

    problem: str = ""
    """Why it cannot be used; "" if it can."""
    key: str = "model"
    """The setting of ``[detector]`` that is to be changed then."""
    text: str = ""
    """Layout, size, milliseconds and boxes, in words."""


def try_model(settings: DetectorSettings, image: Image | None = None) -> ModelReport:
    """Load the model of the settings, run it on an image, and describe it.

    image (H, W, 3): blue, green, red; None for an empty one.
    """
    try:
        model = Model(settings)
    except DetectorError as error:
        return ModelReport(str(error), error.key)
    width, height = model.size
    shown: Image = np.full((height, width, 3), PADDING, np.uint8) if image is None else image

    # The whole image. The first time takes longer.
    crop = whole((shown.shape[1], shown.shape[0]), model.size)
    model.infer(shown, crop)
    began = time.perf_counter()
    found = model.infer(shown, crop)
    milliseconds = 1e3 * (time.perf_counter() - began)
    found = [one for one in found if one.score >= settings.score]

    # Describe it.
    classes = model.form.classes
    kinds = {None: "", 1: ", 1 class"}.get(classes, f", {classes} classes")
    boxes = [
        f"{one.label} {one.score:.2f} at ({one.box[0] / shown.shape[1]:.2f}, "
        f"{one.box[1] / shown.shape[0]:.2f}) to ({one.box[2] / shown.shape[1]:.2f}, "
        f"{one.box[3] / shown.shape[0]:.2f})"
        for one in found[:BOXES_MAX]
    ]
    more = f" and {len(found) - BOXES_MAX} more" if len(found) > BOXES_MAX else ""
    where = "an empty image" if image is None else "the whole image"
    return ModelReport(
        text=f"{model.name}: layout {model.form.layout}, {width}x{height}{kinds}, "
        f"{milliseconds:.0f} ms an inference; in {where}: {', '.join(boxes) or 'nothing'}{more}"
    )
