"""The detector of one view: one more step of the pipeline, between blobs and tracks.

In each frame in which something moves or is tracked it runs inference, as often as it may, and
measures how much of the motion its boxes explain. Where it is trusted (`trust`), the tracker gets
its boxes; elsewhere the blobs of motion.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from camtopod.vision.boxes import Box, Size, scaled
from camtopod.vision.detect import Blob, Motion, moved
from camtopod.vision.detector.crops import crop_around
from camtopod.vision.detector.model import Detection, Image
from camtopod.vision.detector.trust import Trust, objects
from camtopod.vision.settings import DetectorSettings


class InferenceModel(Protocol):
    """Finds objects in images: a `DetectorModel`."""

    size: Size
    """Width and height of its input, pixels."""

    @property
    def engine(self) -> str:
        """Name of the engine that runs it."""

    def infer(self, image: Image, crop: Box) -> list[Detection]:
        """Return the detections in a crop of an image, boxes in pixels of the image."""


class DetectorResult(NamedTuple):
    """What the detector found in a frame, in pixels of the scene at working size."""

    detections: Sequence[Detection] = ()
    is_trusted: bool = False
    """True if the tracker follows its boxes."""
    agreement: float = 0.0
    """Share of the moving area inside of its boxes, a running mean."""


class Detector:
    """The detector of one view. Deterministic: the times are those of the frames."""

    def __init__(self, model: InferenceModel, settings: DetectorSettings) -> None:
        self._model = model
        self._settings = settings
        self.trust = Trust()
        """May be replaced before the first step by that of an earlier detector of this camera."""
        self._due = float("-inf")
        """Time from which on the next inference is allowed, seconds."""
        self.result = DetectorResult()
        """What it found in the latest frame."""
        self._inferences = 0
        self._inference_seconds = 0.0

    def step(
        self,
        t: float,
        image: Image | None,
        motion: Motion,
        view: Box,
        blobs: list[Blob],
        track_boxes: Sequence[Box],
    ) -> list[Blob] | None:
        """Return the objects in the frame captured at ``t`` seconds; None if it was not examined.

        image (H, W, 3): blue, green, red; larger than the working image, or as large. None if it
            was not kept.
        motion: the same frame against the scene, at working size.
        view: part of the scene that it shows; this and what follows in pixels of the scene.
        blobs, track_boxes: motion and tracks.
        """
        is_trusted = self.trust.is_trusted
        regions = [*(blob.box for blob in blobs), *track_boxes]
        self.result = DetectorResult((), is_trusted, self.trust.share)
        if not regions:
            return blobs
        if image is None or t < self._due:
            return None if is_trusted else blobs

        # One inference on all that moves or is tracked.
        self._due = max(self._due + 1.0 / self._settings.looks_per_second_max, t)
        shape = motion.frame.shape
        factor = image.shape[1] / shape[1]
        crop = crop_around(
            [scaled(moved(box, motion.by, shape), factor) for box in regions],
            (image.shape[1], image.shape[0]),
            self._model.size,
        )
        start = time.perf_counter()
        model_detections = self._model.infer(image, crop)
        self._inference_seconds += time.perf_counter() - start
        self._inferences += 1
        back = np.asarray(np.linalg.inv(motion.by), np.float64)
        detections = [
            detection._replace(box=moved(scaled(detection.box, 1 / factor), back, shape))
            for detection in model_detections
        ]

        # Is it trusted? Then its boxes are the objects.
        boxes, outside = objects(
            detections, motion.moving_mask, blobs, track_boxes, view, self._settings.score
        )
        self.trust.add(float((motion.moving_mask != 0).mean()), outside)
        self.result = DetectorResult(detections, self.trust.is_trusted, self.trust.share)
        return boxes if self.trust.is_trusted else blobs

    def statistics(self) -> dict[str, int | float | str]:
        """Return engine, number of inferences, their mean time (milliseconds) and the agreement."""
        return {
            "detector_engine": self._model.engine,
            "detector_looks": self._inferences,
            "detector_look_ms": round(1e3 * self._inference_seconds / max(1, self._inferences), 1),
            "detector_agreement": round(self.trust.share, 3),
        }
