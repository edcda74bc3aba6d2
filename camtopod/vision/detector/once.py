"""What a detector's model is, for people: loaded, and used once."""

from __future__ import annotations

import time

import numpy as np
from msgspec import Struct

from camtopod.vision.detector.crops import whole
from camtopod.vision.detector.model import PADDING, DetectorError, Model, Picture
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


def try_model(settings: DetectorSettings, picture: Picture | None = None) -> ModelReport:
    """Load the model of the settings, look once at a picture, and describe it.

    picture (H, W, 3): blue, green, red; None for an empty one.
    """
    try:
        model = Model(settings)
    except DetectorError as error:
        return ModelReport(str(error), error.key)
    width, height = model.size
    seen: Picture = picture if picture is not None else np.full((height, width, 3), PADDING, "u1")

    # Look at the whole picture. The first time takes longer.
    part = whole((seen.shape[1], seen.shape[0]), model.size)
    model.look(seen, part)
    began = time.perf_counter()
    found = model.look(seen, part)
    milliseconds = 1e3 * (time.perf_counter() - began)
    found = [one for one in found if one.score >= settings.score]

    # Describe it.
    classes = model.form.classes
    kinds = "" if classes is None else ", 1 class" if classes == 1 else f", {classes} classes"
    boxes = [
        f"{one.label} {one.score:.2f} at ({one.box[0] / seen.shape[1]:.2f}, "
        f"{one.box[1] / seen.shape[0]:.2f}) to ({one.box[2] / seen.shape[1]:.2f}, "
        f"{one.box[3] / seen.shape[0]:.2f})"
        for one in found[:BOXES_MAX]
    ]
    more = f" and {len(found) - BOXES_MAX} more" if len(found) > BOXES_MAX else ""
    where = "the whole picture" if picture is not None else "an empty picture"
    return ModelReport(
        text=f"{model.name}: layout {model.form.layout}, {width}x{height}{kinds}, "
        f"{milliseconds:.0f} ms a look; in {where}: {', '.join(boxes) or 'nothing'}{more}"
    )
