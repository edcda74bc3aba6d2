"""A stream or device that may stall, end, or not be there yet -> frames, for ever.

One thread owns the capture (opening, reading and releasing it: another thread doing so crashes) and
may block in it for as long as the timeouts; the caller never does. Frames go through a small queue;
when the caller is slow the oldest go.
"""

from __future__ import annotations

import queue
import random
import threading
import time
from collections.abc import Callable, Iterator
from typing import Literal

from camtopod.vision.settings import VisionSettings
from camtopod.vision.source.capture import Cadence, Capture, Frame
from camtopod.vision.source.ffmpeg_log import Complaints
from camtopod.vision.source.frame_times import StampClock
from camtopod.vision.source.source_url import AGAIN

QUEUE_FRAMES = 8
SETTLE_SECONDS = 1.0
"""Right after opening frames are old by an unknown delay: they wait this long for prompt ones to
tell.
"""
HEARTBEAT_SECONDS = 0.5
"""The caller gets control back at least this often."""
HEALTHY_SECONDS = 10.0
"""A connection that gave frames for this long starts the backoff from the beginning."""
MARGIN_SECONDS = 1.0
"""What a call of OpenCV may take beyond its timeouts."""
TIME_STEP_MIN_SECONDS = 0.001


class LiveSource:
    """Reconnects by itself with jittered, doubling waits."""

    def __init__(
        self,
        source: str,
        settings: VisionSettings,
        wall_clock: Callable[[], float],
        complaints: Complaints | None = None,
    ) -> None:
        self._source = source
        self._settings = settings
        self._wall_clock = wall_clock
        self._complaints = complaints or Complaints()
        self._queue: queue.Queue[Frame] = queue.Queue(QUEUE_FRAMES)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="capture", daemon=True)
        self.state: Literal["connecting", "running", "stalled"] = "connecting"
        self.reason = "not connected yet"
        self.grabbed = 0
        self.dropped = 0
        self.connections = 0
        self.failures = 0
        self.untrusted_stamps = 0
        self._latest = float("-inf")
        self._called: float | None = None

    def frames(self) -> Iterator[Frame | None]:
        """Frames with capture times on the wall clock; None when there was none for half a
        second.
        """
        self._thread.start()
        try:
            while not self._stop.is_set():
                yield self._next()
        finally:
            self.close()  # a thread left in OpenCV at the interpreter's end crashes it

    def _next(self) -> Frame | None:
        try:
            frame = self._queue.get(timeout=HEARTBEAT_SECONDS)
        except queue.Empty:
            return None
        if frame.t < self._latest + TIME_STEP_MIN_SECONDS:  # re-anchored: time goes on all the same
            frame = frame._replace(t=self._latest + TIME_STEP_MIN_SECONDS)
        self._latest = frame.t
        return frame

    @property
    def overdue_seconds(self) -> float:
        """How much longer than the timeouts allow a call of OpenCV has been going on; 0.0 if all is
        well.
        """
        called = self._called
        return (
            0.0
            if called is None
            else max(0.0, time.monotonic() - called - self._blocked_seconds_max)
        )

    @property
    def _blocked_seconds_max(self) -> float:
        return (
            self._settings.open_timeout_seconds
            + self._settings.read_timeout_seconds
            + MARGIN_SECONDS
        )

    def close(self) -> None:
        """Stop; waits for a blocked read to come back, at most the sum of the timeouts."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(self._blocked_seconds_max)

    # -- the capture thread ------------------------------

    def _run(self) -> None:
        wait = self._settings.backoff_min_seconds
        while not self._stop.is_set():
            self._complaints.take()  # of before
            self._called = time.monotonic()
            capture = Capture(self._source, self._settings)
            began = time.monotonic()
            if capture.is_open:
                self.connections += 1
                reason = self._read(capture)
            else:
                why = self._complaints.take()
                reason = f"the source cannot be opened{why and ': '}{why}"
            self._called = time.monotonic()
            capture.release()
            self._called = None
            self.failures += 1
            self.state = "stalled" if self.grabbed else "connecting"
            if time.monotonic() - began > HEALTHY_SECONDS:
                wait = self._settings.backoff_min_seconds
            pause = wait * random.uniform(0.5, 1.0)
            self.reason = f"{reason}{AGAIN}{pause:.1f} s"
            wait = min(2 * wait, self._settings.backoff_max_seconds)
            self._stop.wait(pause)

    def _read(self, capture: Capture) -> str:
        """Hand on frames until the source dies; returns why it did."""
        clock, cadence = StampClock(), Cadence(self._settings.analysed_fps)
        held: list[tuple[float, float, Frame]] = []
        first: float | None = None
        while not self._stop.is_set():
            self._called = asked = time.monotonic()
            grab = capture.grab()
            arrival = time.monotonic()
            if grab is None:
                slow = arrival - asked > 0.9 * self._settings.read_timeout_seconds
                return (
                    "no frame within the read timeout"
                    if slow
                    else "the source ended or closed the connection"
                )
            if arrival - asked > self._settings.read_timeout_seconds / 2:
                self.dropped += 1  # after a stall what comes first is old
                continue
            first = arrival if first is None else first
            self.grabbed += 1
            self.state, self.reason = "running", ""
            clock.see(grab.stamp, arrival)
            if not cadence.wants(grab.stamp if grab.stamp > 0.0 else arrival):
                continue
            luma = capture.retrieve()
            if luma is None:
                self.dropped += 1
                continue
            held.append((grab.stamp, arrival, Frame(0.0, luma)))
            if arrival - first >= SETTLE_SECONDS:
                for stamp, came, frame in held:
                    self._hand_on(frame._replace(t=self._on_the_wall(clock.captured(stamp, came))))
                held.clear()
            self.untrusted_stamps = clock.untrusted
        return "closed"

    def _on_the_wall(self, t: float) -> float:
        """A time of the monotonic clock on the wall clock, which may have been set meanwhile."""
        return self._wall_clock() - (time.monotonic() - t)

    def _hand_on(self, frame: Frame) -> None:
        while True:
            try:
                self._queue.put_nowait(frame)
                return
            except queue.Full:
                try:
                    self._queue.get_nowait()
                    self.dropped += 1
                except queue.Empty:
                    pass
