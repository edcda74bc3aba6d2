"""The detector of one view: one more step of the pipeline, between blobs and tracks.

In each frame it runs inference where something moves or stands, as often as it may, measures how
far it agrees with motion, and returns the blobs to track: those of motion, or, where it is trusted,
those of `fusion`.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol

from camtopod.vision.boxes import Box, contains_centre, scaled
from camtopod.vision.detect import Blob, Luma
from camtopod.vision.detector.crops import Crops
from camtopod.vision.detector.fusion import (
    TrackedBox,
    fuse,
    same_object,
    same_outline,
    share_inside,
)
from camtopod.vision.detector.model import Detection, Image
from camtopod.vision.settings import DetectorSettings

INFERENCES_SAVED_MAX = 2
"""Inferences that can be saved up while nothing moves."""
STANDING_SECONDS = 0.5
"""Time between two inferences on standing people, and for which a detection of them counts."""
USELESS_SECONDS = 1.0
"""Time between two inferences of a detector that detects hardly anything of what moves."""
AREA_SHARE_MIN = 0.0004
"""Least moving area of a crop that counts for the agreement, share of the image."""
TRUSTED_FROM = 0.45
"""Agreement from which a detector is trusted."""
TRUSTED_DOWN_TO = 0.3
"""Agreement below which a detector is trusted no longer."""
USELESS_BELOW = 0.1
"""Agreement below which inferences are a waste of time."""
PRIOR = 0.25
"""Agreement before the first inference."""
PRIOR_AREA = 0.03
"""Moving area (share of the image) that counts as much as the prior."""
INFERENCES_MEMORY = 200
"""Inferences after which an area counts 1/e as much."""
USELESS_INFERENCES_MIN = 30
"""Inferences that are needed to call a detector useless."""


class InferenceModel(Protocol):
    """Finds objects in images: a `Model`."""

    size: tuple[int, int]
    """Width and height of its input, pixels."""

    def infer(self, image: Image, crop: Box) -> list[Detection]:
        """Return the detections in a crop of an image, boxes in pixels of the image."""


class DetectorResult(NamedTuple):
    """What the detector found in a frame, in pixels of the working image."""

    detections: Sequence[Detection] = ()
    trusted: bool = False
    """True if the detector decides on the people in the image and their number."""
    agreement: float = 0.0
    """Share of the moving area inside of its boxes, a running mean."""


class Agreement:
    """Agreement of a detector with motion at one camera; it decides whether it is trusted.

    Measured without ground truth, as the share of the moving area that is inside of the detector's
    boxes. On real views a detector sees most of what moves (0.7 to 0.9) or hardly any of it (0.1
    and less): people from above, cars where it looks for people, a dark image.
    """

    def __init__(self) -> None:
        self._area = PRIOR_AREA
        self._inside = PRIOR * PRIOR_AREA
        self._inferences = 0
        self.trusted = False
        """True if the detections of the detector are tracked, not the blobs of motion alone."""

    def add(self, area: float, inside: float) -> None:
        """Update with one inference: moving area, and the part of it covered by boxes.

        Both as shares of the image.
        """
        kept = 1.0 - 1.0 / INFERENCES_MEMORY
        self._area = kept * self._area + area
        self._inside = kept * self._inside + inside
        self._inferences += 1
        self.trusted = self.share >= (TRUSTED_DOWN_TO if self.trusted else TRUSTED_FROM)

    @property
    def share(self) -> float:
        """The running mean, 0 to 1."""
        return self._inside / self._area

    @property
    def useless(self) -> bool:
        """True if the detector has seen hardly anything of what moves."""
        return self._inferences >= USELESS_INFERENCES_MIN and self.share < USELESS_BELOW


class Detector:
    """The detector of one view. Deterministic: the times are those of the frames."""

    def __init__(self, model: InferenceModel, settings: DetectorSettings) -> None:
        self._model = model
        self._settings = settings
        self._agreement = Agreement()
        self._crops: Crops | None = None
        self._t: float | None = None
        self._saved = 1.0
        """Inferences that may be made now."""
        self._last = float("-inf")
        """Time of the latest inference, seconds."""
        self._standing: list[tuple[float, Box]] = []
        """Times and boxes of the latest detections of standing people."""
        self.result = DetectorResult()
        """What it found in the latest frame."""
        self._inferences = 0
        self._inference_seconds = 0.0

    def step(
        self,
        t: float,
        image: Image,
        moving: Luma,
        blobs: list[Blob],
        tracked: Sequence[TrackedBox],
    ) -> list[Blob]:
        """Return the blobs to track in the frame captured at ``t`` seconds.

        image (H, W, 3): blue, green, red; larger than the working image, or as large.
        moving (h, w): mask of moving pixels of the working image.
        blobs, tracked: motion and tracks, pixels of the working image.
        """
        # Inference where something moves or stands.
        factor = image.shape[1] / moving.shape[1]
        regions = [blob.box for blob in blobs]
        regions += [one.box for one in tracked if one.confirmed]
        only_standing = all(_is_standing(region, tracked) for region in regions)
        crops = self._plan(t, image, [scaled(box, factor) for box in regions], only_standing)
        detections = [
            one._replace(box=scaled(one.box, 1 / factor))
            for crop in crops
            for one in self._infer(image, crop)
        ]
        examined = [scaled(crop, 1 / factor) for crop in crops]

        # Drop those of a low score where nothing is tracked, and duplicates of two crops.
        detections = _without_duplicates(
            one
            for one in detections
            if one.score >= self._settings.score
            or any(same_object(track.box, one.box) for track in tracked)
        )
        self._measure(moving, examined, detections)
        self.result = DetectorResult(detections, self._agreement.trusted, self._agreement.share)

        # Where it is not trusted, motion alone counts.
        if not self._agreement.trusted:
            self._standing.clear()
            return blobs
        boxes = [one.box for one in detections]
        boxes += self._recent_detections(t, boxes, examined, tracked)
        return fuse(blobs, boxes, tracked, moving)

    def detected_recently(self, box: Box) -> bool:
        """Return True if somebody was detected in ``box`` lately (pixels of the working image)."""
        return self._agreement.trusted and (
            any(same_object(box, one.box) for one in self.result.detections)
            or any(same_object(box, standing) for _, standing in self._standing)
        )

    def statistics(self) -> dict[str, int | float]:
        """Return the number of inferences, their mean time (milliseconds) and the agreement."""
        return {
            "detector_looks": self._inferences,
            "detector_look_ms": round(1e3 * self._inference_seconds / max(1, self._inferences), 1),
            "detector_agreement": round(self._agreement.share, 3),
        }

    def _plan(
        self, t: float, image: Image, regions: Sequence[Box], only_standing: bool
    ) -> list[Box]:
        """Return the crops to examine, pixels of the image."""
        # Time earns inferences, up to the rate that is allowed.
        dt = 0.0 if self._t is None else max(0.0, t - self._t)
        self._t = t
        self._saved += dt * self._settings.looks_per_second_max
        self._saved = min(float(INFERENCES_SAVED_MAX), self._saved)

        # Less often on standing people, and where it is of no use.
        pause = 0.0
        inferences = int(self._saved + 1e-6)
        if only_standing:
            pause = STANDING_SECONDS
        if self._agreement.useless:
            pause = USELESS_SECONDS
            inferences = min(inferences, 1)
        if t - self._last < pause or not regions:
            return []

        # Plan.
        size = (image.shape[1], image.shape[0])
        if self._crops is None or size != self._crops.size:
            self._crops = Crops(size, self._model.size)
        crops = self._crops.plan(t, regions, inferences)
        self._saved -= len(crops)
        if crops:
            self._last = t
        return crops

    def _infer(self, image: Image, crop: Box) -> list[Detection]:
        """Run inference on a crop, and count it."""
        began = time.thread_time()
        found = self._model.infer(image, crop)
        self._inference_seconds += time.thread_time() - began
        self._inferences += 1
        return found

    def _measure(self, moving: Luma, crops: Sequence[Box], detections: Sequence[Detection]) -> None:
        """Update with the moving area of each crop, and the part of it inside of detections."""
        boxes = [one.box for one in detections]
        for crop in crops:
            area, inside = share_inside(moving, crop, boxes)
            if area >= AREA_SHARE_MIN * moving.size:
                self._agreement.add(area / moving.size, inside / moving.size)

    def _recent_detections(
        self, t: float, boxes: Sequence[Box], crops: Sequence[Box], tracked: Sequence[TrackedBox]
    ) -> list[Box]:
        """Return recent detections of standing people in regions that were not examined since."""
        recent = [
            (at, box)
            for at, box in self._standing
            if t - at <= STANDING_SECONDS + 0.1
            and not any(contains_centre(crop, box) for crop in crops)
            and _is_standing(box, tracked)
        ]
        self._standing = recent + [(t, box) for box in boxes if _is_standing(box, tracked)]
        return [box for _, box in recent]


def _without_duplicates(detections: Iterable[Detection]) -> list[Detection]:
    """Return the detections, best first, without duplicates in the overlap of two crops (NMS)."""
    kept: list[Detection] = []
    for one in sorted(detections, key=lambda one: -one.score):
        if not any(one.label == other.label and same_outline(one.box, other.box) for other in kept):
            kept.append(one)
    return kept


def _is_standing(region: Box, tracked: Sequence[TrackedBox]) -> bool:
    """Return True if a region is a standing person."""
    return any(one.still and same_object(one.box, region) for one in tracked)
