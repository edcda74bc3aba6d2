"""Frames of a stream or device that may stall, end or not be available yet; endless.

One thread owns the capture: it opens, reads and releases it (from another thread OpenCV crashes)
and may block for as long as the timeouts. The caller never blocks for longer than the heartbeat.
Frames pass through a small queue; if the caller is slow, the oldest are dropped.
"""

from __future__ import annotations

import queue
import random
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

from camtopod.vision.settings import VisionSettings
from camtopod.vision.source.capture import (
    HEARTBEAT_SECONDS,
    PATIENCE,
    Capture,
    Frame,
    FrameSelector,
    Source,
    timeouts,
)
from camtopod.vision.source.ffmpeg_log import FfmpegLog
from camtopod.vision.source.frame_times import StampClock
from camtopod.vision.source.remarks import Observed, no_picture, unfit, why_not_opened, why_over
from camtopod.vision.source.source_url import RETRY_SEPARATOR

QUEUE_FRAMES = 8
"""Frames that wait for the caller; beyond it the oldest are dropped."""
QUEUE_LOOK_SECONDS = 0.01
"""Interval at which room for a frame is looked for."""
SETTLE_SECONDS = 1.0
"""Time for which frames are held after opening.

The first frames are old by an unknown delay; prompt frames that follow reveal it.
"""
BACKOFF_SECONDS_MIN = 0.5
"""Delay before a lost stream is reopened for the first time; it doubles with each attempt."""
BACKOFF_SECONDS_MAX = 15.0
"""Maximum delay before a lost stream is reopened."""
HEALTHY_SECONDS = 10.0
"""Duration of a connection after which the backoff starts from its minimum again."""
MARGIN_SECONDS = 1.0
"""Time that a call of OpenCV may exceed its timeouts by."""
UNDECODED_SECONDS_MAX = 3.0
"""Time without a decoded picture, while frames come, after which a stream does not run."""
TIME_STEP_MIN_SECONDS = 0.001
"""Smallest difference of the capture times of consecutive frames."""
CLOCK_STEP_SECONDS = 0.05
"""Least step of the wall clock that is followed; capture times are no more exact than that."""


class LiveSource(Source):
    """A stream or device that reconnects by itself, with jittered, doubling delays."""

    def __init__(
        self,
        source: str,
        settings: VisionSettings,
        wall_clock: Callable[[], float],
        ffmpeg_log: FfmpegLog | None = None,
        colour: bool = False,
    ) -> None:
        """Prepare to connect.

        colour: frames have an image in colour.
        """
        self._colour = colour
        self._source = source
        self._settings = settings
        self._wall_clock = wall_clock
        self._ffmpeg_log = ffmpeg_log or FfmpegLog()
        self._queue: queue.Queue[Frame] = queue.Queue(QUEUE_FRAMES)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="capture", daemon=True)
        self.reason = "not connected yet"
        self._ahead = wall_clock() - time.monotonic()
        """By how much the wall clock was ahead of the monotonic clock, seconds."""
        self._shift = 0.0
        """By how many seconds the wall clock has been set since then."""
        self._latest = float("-inf")
        self._called: float | None = None
        self._patience = PATIENCE[0]
        """What the source needs, as far as is known."""

    def frames(self) -> Iterator[Frame | None]:
        """Yield frames with ascending capture times; None if there is none for half a second.

        Intervals are those of the monotonic clock; the times are the wall clock's, unless it has
        been set since the beginning: `Frame.shift` says by how much.

        Call it once. `close` or leaving the iteration stops the capture thread.
        """
        self._thread.start()
        try:
            while not self._stop.is_set():
                frame = None
                with suppress(queue.Empty):
                    frame = self._queue.get(timeout=HEARTBEAT_SECONDS)
                yield frame
        finally:
            self.close()  # a thread still in OpenCV at interpreter exit would crash

    @property
    def overdue_seconds(self) -> float:
        """Time that the current call of OpenCV has exceeded its timeouts by; 0.0 if all is well."""
        called = self._called
        if called is None:
            return 0.0
        return max(0.0, time.monotonic() - called - self._blocked_seconds_max)

    @property
    def _blocked_seconds_max(self) -> float:
        """Longest time a call of OpenCV should take."""
        return sum(timeouts(self._patience)) + MARGIN_SECONDS

    def close(self) -> None:
        """Stop; waits for a blocked read, at most the sum of the timeouts."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(self._blocked_seconds_max)

    # -- the capture thread ------------------------------

    def _run(self) -> None:
        """Connect, read, and reconnect after a delay, until stopped."""
        wait = BACKOFF_SECONDS_MIN
        while not self._stop.is_set():
            self._ffmpeg_log.newest_reason()  # discard those of an earlier connection

            began = time.monotonic()
            reason = self._connection()

            # Wait with jitter; the delay doubles unless the connection was healthy.
            self.failures += 1
            if time.monotonic() - began > HEALTHY_SECONDS:
                wait = BACKOFF_SECONDS_MIN
            pause = wait * random.uniform(0.5, 1.0)
            self._lose(f"{reason}{RETRY_SEPARATOR}{pause:.1f} s")
            wait = min(2 * wait, BACKOFF_SECONDS_MAX)
            self._stop.wait(pause)

    def _connection(self) -> str:
        """Open the source and read it until it dies; return the reason.

        `_called` marks the begin of each call that may block.
        """
        self._called = time.monotonic()
        capture = Capture(
            self._source, self._settings, self._colour, self._ffmpeg_log, self._patience
        )
        try:
            if not capture.is_open:
                why = why_not_opened(self._source, self._ffmpeg_log)
                return f"the source cannot be opened{why and ': '}{why}"
            self.connections += 1
            return unfit(self._source, capture) or self._read(capture)
        finally:
            self._called = time.monotonic()
            capture.release()
            self._called = None

    def _read(self, capture: Capture) -> str:
        """Pass frames on until the source dies; return the reason."""
        clock = StampClock()
        selector = FrameSelector(self._settings.analysed_fps)
        observed = Observed(capture.size)
        held: list[tuple[float, float, Frame]] = []
        began = decoded = time.monotonic()
        frames = 0
        moment = float("-inf")
        while not self._stop.is_set():
            # Grab a frame.
            self._called = asked = time.monotonic()
            stamp = capture.grab()
            arrival = time.monotonic()
            if stamp is None:
                return self._why_ended(capture, clock, frames, arrival - asked, decoded - began)
            if not frames:
                began = decoded = arrival
            frames += 1
            self.grabbed += 1

            # Decode it if it is to be analysed.
            clock.record(stamp, arrival)
            moment = max(moment, clock.captured(stamp, arrival) or arrival)
            if not selector.wants(moment):
                observed.add(arrival, None)
                continue
            retrieved = capture.frame()
            if retrieved is None:
                self.dropped += 1
                if arrival - decoded > UNDECODED_SECONDS_MAX:
                    self._lose(f"frames come, none can be decoded: {capture.fault}")
                continue
            decoded = arrival
            observed.add(arrival, retrieved.luma)

            # Hold it until the clock has settled, then pass it on with its capture time.
            held.append((stamp, arrival, retrieved))
            if arrival - began >= SETTLE_SECONDS:
                self.state = "running"
                self.reason = observed.words
                for one in held:
                    self._hand_on(clock, *one)
                held.clear()
        return "closed"

    def _why_ended(
        self, capture: Capture, clock: StampClock, frames: int, waited: float, ran: float
    ) -> str:
        """Return why a connection gives no frame any more, and note if it needs more patience.

        frames: number of its frames.
        waited: time that the last call took, seconds.
        ran: time from its first frame to the last one that was decoded, seconds.
        """
        timed_out = waited > 0.9 * timeouts(self._patience)[1]
        if (timed_out and ran < HEALTHY_SECONDS) or (not frames and capture.size == (0, 0)):
            self._patience = next(
                (more for more in PATIENCE if more > self._patience), PATIENCE[-1]
            )
        if not frames:
            return f"it opens, but gives no picture: {no_picture(capture)}"
        if timed_out:
            return "no frame within the read timeout"
        why = why_over(self._source, frames, clock)
        return why or "the source ended or closed the connection"

    def _lose(self, reason: str) -> None:
        """Say that there are no pictures, or none any more."""
        self.state = "stalled" if self._latest > float("-inf") else "connecting"
        self.reason = reason.removesuffix(": ")

    def _hand_on(self, clock: StampClock, stamp: float, arrival: float, frame: Frame) -> None:
        """Queue a frame with its capture time.

        If the queue is full, a frame of a burst waits for as long as it came late, as the next
        burst takes as long to come; then the oldest one is dropped. Nobody else puts any in.
        """
        captured = clock.captured(stamp, arrival)
        if captured is None:
            self.untrusted_stamps += 1
            captured = arrival
        self._latest = max(captured, self._latest + TIME_STEP_MIN_SECONDS)
        shift = self._wall_clock() - time.monotonic() - self._ahead
        if abs(shift - self._shift) > CLOCK_STEP_SECONDS:
            self._shift = shift
        frame = frame._replace(t=self._latest + self._ahead, shift=self._shift)
        self._called = None
        for _ in range(round((arrival - captured) / QUEUE_LOOK_SECONDS)):
            if not self._queue.full() or self._stop.wait(QUEUE_LOOK_SECONDS):
                break
        if self._queue.full():
            with suppress(queue.Empty):  # the caller has just taken one
                self._queue.get_nowait()
                self.dropped += 1
        self._queue.put_nowait(frame)
