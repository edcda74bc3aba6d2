"""The detector of one view: one more step of the pipeline, between blobs and tracks.

In each frame it looks where something moves or stands, as often as it may, measures how far it
agrees with motion, and returns the blobs to track: those of motion, or, where it is trusted, those
of `fusion`.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol

from camtopod.vision.boxes import Box, contains_centre, scaled
from camtopod.vision.detect import Blob, Luma
from camtopod.vision.detector.agreement import Agreement
from camtopod.vision.detector.crops import Crops
from camtopod.vision.detector.fusion import Known, fuse, same, same_box, share_inside
from camtopod.vision.detector.model import Detection, Picture
from camtopod.vision.settings import DetectorSettings

INFERENCES_SAVED_MAX = 2
"""Looks that can be saved up while nothing moves."""
STANDING_SECONDS = 0.5
"""Time between two looks at people who stand, and for which a detection of them counts."""
USELESS_SECONDS = 1.0
"""Time between two looks of a detector that sees hardly anything of what moves."""
AREA_SHARE_MIN = 0.0004
"""Least moving area of a look that counts for the agreement, share of the picture."""


class Looks(Protocol):
    """What looks at pictures: a `Model`."""

    size: tuple[int, int]
    """Width and height of its input, pixels."""

    def look(self, picture: Picture, part: Box) -> list[Detection]:
        """Return what is in a part of the picture, boxes in pixels of the picture."""


class Seen(NamedTuple):
    """What the detector saw of a frame, in pixels of the working picture."""

    parts: Sequence[Box] = ()
    """Parts that were looked at."""
    detections: Sequence[Detection] = ()
    trusted: bool = False
    """The detector decides who is there and how many."""
    agreement: float = 0.0
    """Share of the moving area inside of its boxes, a running mean."""


class Detector:
    """The detector of one view. Deterministic: the times are those of the frames."""

    def __init__(self, model: Looks, settings: DetectorSettings) -> None:
        self._model = model
        self._settings = settings
        self._agreement = Agreement()
        self._crops: Crops | None = None
        self._size = (0, 0)
        self._t: float | None = None
        self._saved = 1.0
        """Looks that may be made now."""
        self._last = float("-inf")
        """Time of the latest look, seconds."""
        self._standing: list[tuple[float, Box]] = []
        """Times and boxes of the latest detections of people who stand."""
        self.seen = Seen()
        """What it saw of the latest frame."""
        self._looks = 0
        self._seconds = 0.0

    def step(
        self,
        t: float,
        picture: Picture,
        moving: Luma,
        blobs: list[Blob],
        known: Sequence[Known],
    ) -> list[Blob]:
        """Return the blobs to track in the frame captured at ``t`` seconds.

        picture (H, W, 3): blue, green, red; larger than the working picture, or as large.
        moving (h, w): mask of moving pixels of the working picture.
        blobs, known: motion and tracks, pixels of the working picture.
        """
        # Look where something moves, or stands.
        factor = picture.shape[1] / moving.shape[1]
        regions = [blob.box for blob in blobs]
        regions += [one.box for one in known if one.confirmed]
        only_standing = all(_stands(region, known) for region in regions)
        parts = self._plan(t, picture, [scaled(box, factor) for box in regions], only_standing)
        detections = [
            one._replace(box=scaled(one.box, 1 / factor))
            for part in parts
            for one in self._look(picture, part)
        ]
        looked = [scaled(part, 1 / factor) for part in parts]

        # Drop faint ones that nothing is known of, and those that two parts share.
        detections = _distinct(
            one
            for one in detections
            if one.score >= self._settings.score or any(same(k.box, one.box) for k in known)
        )
        self._measure(moving, looked, detections)
        self.seen = Seen(looked, detections, self._agreement.trusted, self._agreement.share)

        # Where it is not trusted, motion alone counts.
        if not self._agreement.trusted:
            self._standing.clear()
            return blobs
        boxes = [one.box for one in detections]
        held = self._held(t, boxes, looked, known)
        return fuse(blobs, boxes + held, looked, known, moving)

    def holds(self, box: Box) -> bool:
        """Return True if somebody was detected in ``box`` lately (working picture)."""
        return self._agreement.trusted and (
            any(same(box, one.box) for one in self.seen.detections)
            or any(same(box, standing) for _, standing in self._standing)
        )

    def statistics(self) -> dict[str, int | float]:
        """Return looks, their mean time (milliseconds) and the agreement."""
        return {
            "detector_looks": self._looks,
            "detector_look_ms": round(1e3 * self._seconds / max(1, self._looks), 1),
            "detector_agreement": round(self._agreement.share, 3),
        }

    def _plan(
        self, t: float, picture: Picture, regions: Sequence[Box], only_standing: bool
    ) -> list[Box]:
        """Return the parts of the picture to look at, pixels of the picture."""
        # Time brings looks, up to the rate that is allowed.
        dt = 0.0 if self._t is None else max(0.0, t - self._t)
        self._t = t
        earned = dt * self._settings.looks_per_second_max
        self._saved = min(float(INFERENCES_SAVED_MAX), self._saved + earned)

        # Less often at people who stand, and where it is of no use.
        pause = STANDING_SECONDS if only_standing else 0.0
        pause = USELESS_SECONDS if self._agreement.useless else pause
        looks = min(1 if self._agreement.useless else INFERENCES_SAVED_MAX, int(self._saved + 1e-6))
        if t - self._last < pause or not regions:
            return []

        # Plan.
        size = (picture.shape[1], picture.shape[0])
        if self._crops is None or size != self._size:
            self._crops, self._size = Crops(size, self._model.size), size
        parts = self._crops.plan(t, regions, looks)
        self._saved -= len(parts)
        self._last = t if parts else self._last
        return parts

    def _look(self, picture: Picture, part: Box) -> list[Detection]:
        """Look at a part of the picture, and count it."""
        began = time.thread_time()
        found = self._model.look(picture, part)
        self._seconds += time.thread_time() - began
        self._looks += 1
        return found

    def _measure(
        self, moving: Luma, looked: Sequence[Box], detections: Sequence[Detection]
    ) -> None:
        """Count the moving area of each look, and how much of it is inside of detections."""
        boxes = [one.box for one in detections]
        for part in looked:
            area, inside = share_inside(moving, part, boxes)
            if area >= AREA_SHARE_MIN * moving.size:
                self._agreement.add(area / moving.size, inside / moving.size)

    def _held(
        self, t: float, boxes: Sequence[Box], looked: Sequence[Box], known: Sequence[Known]
    ) -> list[Box]:
        """Return detections of people who stand, of a moment ago, where it has not looked since."""
        held = [
            (at, box)
            for at, box in self._standing
            if t - at <= STANDING_SECONDS + 0.1
            and not any(contains_centre(part, box) for part in looked)
            and any(one.still and same(one.box, box) for one in known)
        ]
        fresh = [
            (t, box) for box in boxes if any(one.still and same(one.box, box) for one in known)
        ]
        self._standing = held + fresh
        return [box for _, box in held]


def _distinct(detections: Iterable[Detection]) -> list[Detection]:
    """Return the detections, best first, without those of an object in the overlap of two parts."""
    kept: list[Detection] = []
    for one in sorted(detections, key=lambda one: -one.score):
        if not any(one.label == other.label and same_box(one.box, other.box) for other in kept):
            kept.append(one)
    return kept


def _stands(region: Box, known: Sequence[Known]) -> bool:
    """Return True if a region is a person who stands."""
    return any(one.still and same(one.box, region) for one in known)
