"""Inputs of a model: one image, and perhaps the size in whose units it gives boxes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from camtopod.vision.boxes import Size
from camtopod.vision.detector.errors import DetectorError

SIZE_UNKNOWN = 640
"""Width and height (pixels) at which a model is used that leaves its size open."""


class Inputs(NamedTuple):
    """Inputs of a model."""

    size: Size
    """Width and height of the image that it takes, pixels."""
    image: str
    """Name of the input for the image."""
    target: str
    """Name of the input for the width and height in whose units it gives boxes; "" if none."""


def recognise_inputs(path: str, shapes: Mapping[str, Sequence[int]]) -> Inputs:
    """Return the inputs of the model at ``path``.

    shapes: of each input by its name; 0 where a length is left open.

    Raises `DetectorError` if they are not those of a detector.
    """
    images = {
        name: shape
        for name, shape in shapes.items()
        if len(shape) == 4 and shape[0] < 2 and shape[1] in (0, 3)
    }
    targets = [name for name, shape in shapes.items() if len(shape) == 2 and shape[1] == 2]
    if len(images) != 1 or len(targets) > 1 or len(images) + len(targets) != len(shapes):
        listed = " and ".join(str(tuple(shape)) for shape in shapes.values()) or "none"
        raise DetectorError(
            "model", f"{path} does not take one image (1, 3, height, width); its inputs: {listed}"
        )
    ((image, shape),) = images.items()
    height, width = (length or SIZE_UNKNOWN for length in shape[2:])
    return Inputs((width, height), image, "".join(targets))
