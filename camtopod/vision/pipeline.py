"""Frames of one view -> events: detection, tracking, crossings. Has no source, clock or waiting."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Sequence
from math import dist
from typing import NamedTuple

from camtopod.records import Event
from camtopod.vision.blindness import Blindness, Cause
from camtopod.vision.detect import Blob, Luma, MotionDetector, find_blobs, shrunk
from camtopod.vision.detector.detector import Detector, DetectorResult
from camtopod.vision.settings import VisionSettings
from camtopod.vision.track import (
    Crossings,
    Decision,
    FrameView,
    IgnoredAreas,
    Reason,
    Track,
    Tracker,
)

GHOST_SECONDS = 3.0
"""An object that has not moved for this long is tested for being a ghost.

A ghost is the hole that an object leaves in the background model.
"""
GHOST_REACH_HEIGHTS = 1.0
"""Largest distance (heights) that something has moved that may still be a ghost."""
GHOST_MOVE_HEIGHTS = 0.1
"""An object that moves less than this (heights of the object) stands still."""
STEP_SECONDS_MAX = 1.0
"""Longest interval between two frames that background learning takes into account."""
BOOTSTRAP_SECONDS = 3.0
"""The first background is the median of the frames of this period."""
BOOTSTRAP_FRAMES_KEPT = 100
"""Number of frames that may wait for the first background."""
FIRST_IMAGES_PER_SECOND = 7.0
"""Images in colour that wait with them, per second: 22 in all."""
FIRST_IMAGES_SIDE_MAX = 960
"""Longer side (pixels) to which they are scaled down: 1.6 MB each at 960 x 540."""


class Analysis(NamedTuple):
    """One frame and its analysis.

    Holds the pipeline's own objects, which change with the next frame.
    """

    t: float
    """Capture time, seconds."""
    frame: Luma
    """The working image (H, W), filtered if it was noisy."""
    moving_mask: Luma | None
    """Mask (H, W) of the foreground; None while the view is blind, or most of the image differs."""
    tracks: Sequence[Track]
    """Tracks that are followed, tentative ones included."""
    learned_doors: Sequence[tuple[float, float]]
    """Foot points of learned doors, pixels."""
    events: Sequence[Event]
    """Events that have become certain in this frame."""
    decisions: Sequence[Decision]
    """Beginnings and ends of tracks that were decided in this frame."""
    detector: DetectorResult | None = None
    """What the detector found; None if there is none, or it has not seen the frame."""


Observer = Callable[[Analysis], None]
"""Called with every analysed frame, and with the one that ends a scene before that is learned."""


class ViewPipeline:
    """Turns one view's frames into events. Deterministic: equal frames and times, equal events."""

    def __init__(
        self,
        camera: str,
        settings: VisionSettings,
        observer: Observer | None = None,
        detector: Detector | None = None,
    ) -> None:
        """Prepare for the first frame.

        observer: called with every analysed frame; the events do not depend on it.
        detector: finds people in moving regions; None: motion alone.
        """
        self._camera = camera
        self._settings = settings
        self._observer = observer
        self._detector = detector
        self._decisions: list[Decision] = []
        self._counts: Counter[Reason] = Counter()
        """Number of decisions by reason."""
        self._numbers = itertools.count(1)
        self._latest: Analysis | None = None
        self._motion = MotionDetector(settings)
        self._first_frames: list[tuple[float, Luma, Luma | None]] = []
        self._tracker: Tracker | None = None
        self._t: float | None = None
        self.frame_count = 0
        self._blindness = Blindness()

    def process(self, t: float, frame: Luma, image: Luma | None = None) -> list[Event]:
        """Process the frame (H, W) captured at ``t`` (seconds) and return the events now certain.

        Times must increase. The frames of the first seconds wait until there is a background, then
        all of them are analysed.

        image (H, W, 3): the same frame in colour and at full size, for the detector.
        """
        self.frame_count += 1
        small = self._motion.filter_noise(shrunk(frame, self._settings.working_width))
        if self._motion.ready:
            return self._step(t, small, image)

        # Tracking ends: the scene has changed, or the image its size.
        events = []
        if self._first_frames and self._first_frames[0][1].shape != small.shape:
            self._first_frames.clear()
        if not self._first_frames and self._tracker is not None:
            events = self._tracker.finish("scene changed")
            self._show(t, small, None, events)
            self._blindness.turned(t)
        waiting_seconds = t - self._first_frames[0][0] if self._first_frames else 0.0
        self._first_frames.append((t, small, self._first_image(image, waiting_seconds)))
        enough = waiting_seconds >= BOOTSTRAP_SECONDS
        if enough or len(self._first_frames) >= BOOTSTRAP_FRAMES_KEPT:
            events += self._bootstrap()
        return events

    def _first_image(self, image: Luma | None, waiting_seconds: float) -> Luma | None:
        """Return an image to examine later, scaled down; None if enough of them wait."""
        waiting_count = sum(waiting is not None for _, _, waiting in self._first_frames)
        is_enough = waiting_count >= 1 + FIRST_IMAGES_PER_SECOND * waiting_seconds
        if self._detector is None or image is None or is_enough:
            return None
        return shrunk(image, FIRST_IMAGES_SIDE_MAX)

    def _bootstrap(self) -> list[Event]:
        """Initialise the background from the waiting frames, then analyse them."""
        first_frames = self._first_frames
        self._first_frames = []
        is_other = self._motion.bootstrap([frame for _, frame, _ in first_frames])
        height, width = first_frames[0][1].shape

        # Begin tracking; for the same scene, keep the learned heights and doors.
        events = []
        size = width, height
        if self._tracker is None or is_other or self._tracker.crossings.size != size:
            crossings = Crossings(
                self._camera,
                width,
                height,
                self._settings.doors,
                IgnoredAreas(self._motion.watched_mask),
                self._take,
            )
            self._tracker = Tracker(self._settings, crossings, self._numbers)
        self._tracker.crossings.begin(first_frames[0][0], IgnoredAreas(self._motion.watched_mask))
        self._t = None
        for t, frame, image in first_frames:
            if self._motion.ready:
                events += self._step(t, frame, image)
        return events

    def _step(self, t: float, frame: Luma, image: Luma | None = None) -> list[Event]:
        """Analyse one frame. While the view is blind, nothing is tracked."""
        assert self._tracker is not None
        dt = 0.0 if self._t is None else min(max(0.0, t - self._t), STEP_SECONDS_MAX)
        self._t = t

        # Moving pixels against the background; none in a flash, and when the scene has changed.
        motion = self._motion.detect(frame, dt)
        cause: Cause | None = "light" if motion is None else "contrast" if motion.is_plain else None
        self._blindness.step(t, dt, cause)
        if self._blindness.reason or motion is None:
            last_events = self._tracker.finish("blind") if self._blindness.reason else []
            if motion is not None:
                self._motion.learn(motion, dt, [])
            self._show(t, frame, None, last_events)
            return last_events

        # Blobs, tracks, events.
        blobs = find_blobs(motion, self._tracker.stature.height)
        objects: list[Blob] | None = blobs
        is_trusted = False
        if self._detector is not None:
            objects = self._detector.step(
                t,
                image,
                motion,
                self._motion.view,
                blobs,
                [track.box for track in self._tracker.active],
            )
            is_trusted = self._detector.result.is_trusted
        frame_view = FrameView(t, self._motion.view, is_trusted)
        events = [] if objects is None else self._tracker.step(frame_view, objects)

        # Drop ghosts; a detector that is trusted knows none.
        for track in self._tracker.active:
            still = not is_trusted and _is_still(track, t)
            if still and self._motion.is_ghost(motion, track.last.box):
                self._tracker.drop(track)

        # Learn the background outside of confirmed tracks.
        claimed_boxes = [
            track.last.box if track.last.t == t else track.box
            for track in self._tracker.active
            if track.confirmed
        ]
        self._motion.learn(motion, dt, claimed_boxes)
        self._show(t, motion.frame, motion.moving_mask, events)
        return events

    def _take(self, decision: Decision) -> None:
        """Count a decision, and keep it for the observer, if there is one."""
        self._counts[decision.reason] += 1
        if self._observer is not None:
            self._decisions.append(decision)

    def _show(
        self, t: float, frame: Luma, moving_mask: Luma | None, events: Sequence[Event]
    ) -> None:
        """Pass the analysis of a frame to the observer, if there is one."""
        if self._observer is None:
            return
        assert self._tracker is not None
        self._latest = Analysis(
            t,
            frame,
            moving_mask,
            self._tracker.active,
            self._tracker.crossings.doors.learned(self._tracker.stature.height),
            events,
            self._decisions.copy(),
            None if self._detector is None or moving_mask is None else self._detector.result,
        )
        self._decisions.clear()
        self._observer(self._latest)

    def finish(self) -> list[Event]:
        """Return the remaining events at the end of a recording.

        Objects still in view have no exit.
        """
        events = self._bootstrap() if self._first_frames else []
        if self._tracker is not None:
            last_events = self._tracker.finish("in view")
            if self._observer is not None and self._latest is not None:
                self._observer(self._latest._replace(events=last_events, decisions=self._decisions))
            events += last_events
        return events

    @property
    def reason(self) -> str:
        """Why nothing can be told at present; "" if the view is not blind."""
        return self._blindness.reason

    def statistics(self) -> dict[str, int | float | str]:
        """Return counters since the start, noise (grey levels) and shake (pixels)."""
        tracker = self._tracker
        return {
            "entries": self._counts["entered"],
            "exits": self._counts["left"],
            "tracks_active": sum(track.confirmed for track in tracker.active) if tracker else 0,
            "frames_analysed": self.frame_count,
            "ghosts": self._counts["ghost"],
            "relearned": self._motion.relearn_count,
            "blind_seconds": round(self._blindness.seconds, 1),
            "noise_grey_levels": round(self._motion.noise, 2),
            "shake_pixels": round(self._motion.shake, 2),
            **({} if self._detector is None else self._detector.statistics()),
        }


def _is_still(track: Track, t: float) -> bool:
    """Return True if the track is seen now and has stayed in place for `GHOST_SECONDS`.

    Movement is judged over the sightings that are kept. What has come here from elsewhere is an
    object that stands.
    """
    has_moved = track.confirmed and track.reach > GHOST_REACH_HEIGHTS * track.height
    return (
        track.last.t == t
        and t - track.first.t >= GHOST_SECONDS
        and len(track.history) == track.history.maxlen
        and not has_moved
        and dist(track.history[0].foot, track.last.foot) < GHOST_MOVE_HEIGHTS * track.height
    )
