"""Settings of a grabber (``[vision]`` and ``[detector]`` of the configuration), with their units.

``[vision]`` holds for all cameras; each of its keys may also stand in ``[cameras.ID]``, for that
camera alone. The same holds for ``[detector]`` and ``[cameras.ID.detector]``.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

Positive = Annotated[float, Meta(gt=0)]

Fraction = Annotated[float, Meta(ge=0, le=1)]
Point = tuple[Fraction, Fraction]
"""x and y in fractions of the image's width and height, x to the right, y down."""
Polygon = tuple[Point, ...]
"""An area of the image by its corners; a single point stands for a place."""

_FORM = "of three points or more in fractions of the image, like [[[x, y], [x, y], [x, y]]]"
Areas = Annotated[
    tuple[Annotated[Polygon, Meta(min_length=3)], ...], Meta(description=f"polygons {_FORM}")
]
"""Polygons of three points or more."""
Places = Annotated[
    tuple[Annotated[Polygon, Meta(min_length=1)], ...],
    Meta(description=f"points, or polygons {_FORM}"),
]
"""Points, and polygons of three points or more."""


class VisionSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[vision]``: how frames become events. Each key may also stand in ``[cameras.ID]``, for
    that camera alone.
    """

    analysed_fps: Positive = 7.0
    """Frames per second to analyse, as near as the source's rate allows; the rest is only grabbed.
    """
    working_width: Annotated[int, Meta(ge=1)] = 320
    """Wider frames are scaled down to this width (pixels) before analysis, portrait ones to the
    same area: this is their height.
    """
    ignore: Areas = ()
    """Areas in which motion is ignored (a tree, a street behind the fence, a clock in the
    image): polygons of [x, y] points in fractions of the image, such as [[[0.0, 0.0],
    [0.3, 0.0], [0.3, 0.1], [0.0, 0.1]]], or texts as Frigate's "0,0,0.3,0,0.3,0.1,0,0.1".
    """
    doors: Places = ()
    """Places in mid-view where people may appear and disappear, besides those that are learned:
    points [x, y] (the feet are within 0.6 of the person's height) or polygons (the feet are
    inside), such as [[0.42, 0.35]]; fractions of the image.
    """
    min_height: Annotated[float, Meta(ge=0, lt=1)] = 0.0
    """Least height of an object, as a fraction of the image's height; lower ones (cats, birds,
    people far away) make no events.
    """
    sensitivity: Annotated[float, Meta(ge=0.25, le=4)] = 1.0
    """How faint motion may be, 0.25 to 4: at 2 half of the usual contrast to the background is
    enough, at 0.5 twice as much is needed. More than the measured noise is needed in any case.
    """


Layout = Literal["yolox", "yolov8", "end-to-end", "rt-detr"]
"""How a detector's model writes the boxes that it finds."""


class DetectorSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[detector]``: a detector of people beside the motion, a model that is on this machine. Each
    key may also stand in ``[cameras.ID.detector]``; ``[cameras.ID] detector = false`` does without.
    """

    model: str = ""
    """The model, an ONNX file; a path as in [bus.tls]. Nothing is downloaded; deploy/detector.md
    says where such models come from. Empty: motion alone.
    """
    labels: tuple[str | Annotated[int, Meta(ge=0)], ...] = ("person",)
    """What makes events: labels of COCO, such as ["person", "bicycle"], or numbers of the model's
    classes, from 0.
    """
    score: Annotated[float, Meta(gt=0, le=1)] = 0.4
    """Least score of a detection, 0 to 1; 3/8 of it is enough where something is tracked already.
    """
    looks_per_second_max: Annotated[float, Meta(ge=1)] = 7.0
    """Maximum number of inferences per second and camera, 1 or more, on the region where something
    moves or is tracked.
    """
    layout: Annotated[
        str,
        Meta(
            pattern=r"^$|^(yolox|yolov8|end-to-end|rt-detr)\Z",
            description="one of yolox, yolov8, end-to-end and rt-detr",
        ),
    ] = ""
    """Layout of the model's outputs: yolox, yolov8 (also of later ones), end-to-end or rt-detr;
    empty: it is recognised, or `camtopod check` asks for it.
    """
