"""Frames -> events: the whole of a grabber that needs no source, no clock and no waiting."""

from __future__ import annotations

from camtopod.records import Event
from camtopod.vision.detect import Luma, MotionDetector, find_blobs, shrunk
from camtopod.vision.settings import VisionSettings
from camtopod.vision.track import Crossings, Track, Tracker, went_somewhere

GHOST_SECONDS = 3.0
"""An object that has not moved for this long is looked at again: it may be where something was."""
GHOST_MOVE_HEIGHTS = 0.1
STEP_SECONDS_MAX = 1.0
"""A gap between two pictures counts as no more than this for what is learned of the scene."""
BOOTSTRAP_FRAMES_KEPT = 100
"""At most so many pictures wait for the first background."""


class Watcher:
    """One view's frames to events. Same frames and times in, same events out."""

    def __init__(self, camera: str, settings: VisionSettings) -> None:
        self._camera = camera
        self._settings = settings
        self._motion = MotionDetector(settings)
        self._waiting: list[tuple[float, Luma]] = []
        self._tracker: Tracker | None = None
        self._crossings: Crossings | None = None
        self._t: float | None = None
        self.analysed = 0
        self.ghosts = 0

    def see(self, t: float, frame: Luma) -> list[Event]:
        """Take the picture (H, W) captured at ``t`` seconds, later than the last; returns what
        became certain by it.

        The first seconds' pictures wait until there is a background, then all are looked at.
        """
        self.analysed += 1
        small = self._motion.clean(shrunk(frame, self._settings.working_width))
        if self._tracker is not None and self._motion.ready:
            return self._step(t, small)
        self._waiting.append((t, small))
        enough = t - self._waiting[0][0] >= self._settings.bootstrap_seconds
        if enough or len(self._waiting) >= BOOTSTRAP_FRAMES_KEPT:
            return self._bootstrap()
        return []

    def _bootstrap(self) -> list[Event]:
        waiting, self._waiting = self._waiting, []
        self._motion.bootstrap([frame for _, frame in waiting])
        height, width = waiting[0][1].shape
        if self._crossings is None or self._tracker is None:
            self._crossings = Crossings(self._camera, width, height)
            self._tracker = Tracker(self._settings, self._crossings)
        else:
            self._tracker.restart()
        self._t = None
        events = []
        for t, frame in waiting:
            if self._motion.ready:
                events += self._step(t, frame)
        return events

    def _step(self, t: float, frame: Luma) -> list[Event]:
        assert self._tracker is not None
        assert self._crossings is not None
        dt = 0.0 if self._t is None else min(max(0.0, t - self._t), STEP_SECONDS_MAX)
        self._t = t
        motion = self._motion.look(frame, dt)
        if motion is None:  # another picture altogether: begin again
            return []
        if self._motion.disturbed:  # a flash, or the first moments of such another picture
            return []
        blobs = find_blobs(motion, self._tracker.stature.height)
        changes = self._tracker.step(t, blobs)
        events = self._crossings.report(changes, self._tracker.active)
        for track in self._tracker.active:
            if self._is_still(track, t) and self._motion.is_ghost(frame, motion, track.last.box):
                self._tracker.drop(track)
                self.ghosts += 1
        claimed = [
            track.last.box if track.last.t == t else track.box
            for track in self._tracker.active
            if track.confirmed
        ]
        self._motion.learn(frame, motion, dt, claimed)
        return events

    def _is_still(self, track: Track, t: float) -> bool:
        """Seen now, and for `GHOST_SECONDS` (as far as is remembered) in one place."""
        past = track.history[0]
        if track.last.t < t or len(track.history) < 8 or t - track.first.t < GHOST_SECONDS:
            return False
        reach = GHOST_MOVE_HEIGHTS * track.height
        return (
            abs(past.foot[0] - track.last.foot[0]) < reach
            and abs(past.foot[1] - track.last.foot[1]) < reach
        )

    def finish(self) -> list[Event]:
        """The recording is over: what is certain now. Objects still in view have no exit."""
        events = self._bootstrap() if self._waiting else []
        if self._tracker is not None and self._crossings is not None and self._t is not None:
            events += [
                self._crossings.exit(x) for x in self._tracker.finish(self._t) if went_somewhere(x)
            ]
        return events

    def statistics(self) -> dict[str, int | float]:
        """Counters since the start, and the noise in grey levels."""
        tracker, crossings = self._tracker, self._crossings
        return {
            "frames_analysed": self.analysed,
            "entries": crossings.entries if crossings else 0,
            "exits": crossings.exits if crossings else 0,
            "tracks_active": sum(track.confirmed for track in tracker.active) if tracker else 0,
            "tracks_broken": len(tracker.broken) if tracker else 0,
            "tracks_stitched": tracker.stitched if tracker else 0,
            "ghosts": self.ghosts,
            "relearned": self._motion.relearned,
            "noise_grey_levels": round(self._motion.noise, 2),
            "shake_pixels": round(self._motion.shake, 2),
        }
