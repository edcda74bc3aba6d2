"""Frames of a stream or device that may stall, end or not be available yet; endless.

One thread owns the capture: it opens, reads and releases it (from another thread OpenCV crashes)
and may block for as long as the timeouts. The caller never blocks for longer than the heartbeat.
Frames pass through a small queue; if the caller is slow, some are dropped.
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
    CALL_SECONDS_MAX,
    HEARTBEAT_SECONDS,
    Capture,
    Frame,
    FrameSelector,
    Source,
    call_seconds_max,
)
from camtopod.vision.source.ffmpeg_log import NO_LOG, FfmpegLog
from camtopod.vision.source.frame_times import PROMPT_SECONDS, StampClock
from camtopod.vision.source.refusal import why_not_opened
from camtopod.vision.source.remarks import (
    OBSERVED_SECONDS,
    RTSP_RECORDING,
    Observed,
    Playback,
    is_rtsp,
    no_frame,
    no_stream,
)
from camtopod.vision.source.source_url import RETRY_SEPARATOR, scheme_of

QUEUE_FRAMES = 8
"""Frames that wait for the caller; further ones are dropped."""
SETTLE_SECONDS = 1.0
"""Time for which frames are held after opening.

The first frames are old by an unknown delay; prompt frames that follow reveal it.
"""
BACKOFF_SECONDS_MAX = 15.0
"""Maximum delay before a lost stream is reopened; it begins at the heartbeat, and doubles."""


class LiveSource(Source):
    """A stream or device that reconnects by itself, with jittered, doubling delays."""

    def __init__(
        self,
        source: str,
        settings: VisionSettings,
        wall_clock: Callable[[], float],
        ffmpeg_log: FfmpegLog = NO_LOG,
        colour: bool = False,
    ) -> None:
        """Prepare to connect.

        colour: frames have an image in colour.
        """
        self._colour = colour
        self._source = source
        self._settings = settings
        self._wall_clock = wall_clock
        self._ffmpeg_log = ffmpeg_log
        self._queue: queue.Queue[Frame] = queue.Queue(QUEUE_FRAMES)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="capture", daemon=True)
        self.reason = "not connected yet"
        self._ahead = wall_clock() - time.monotonic()
        """By how much the wall clock was ahead of the monotonic clock, seconds."""
        self._shift = 0.0
        """By how many seconds the wall clock has been set since then."""
        self._latest = float("-inf")
        """Capture time of the latest frame."""
        self._playback = Playback()
        self._call_start: float | None = None
        self._patient = False
        """True if the source is known to need patience."""
        self._bare_jpeg = False
        """True if JPEG pictures are found by their markers, as the parts have wrong headers."""

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
        call_start = self._call_start
        if call_start is None:
            return 0.0
        return max(0.0, time.monotonic() - call_start - self._blocked_seconds_max)

    @property
    def _blocked_seconds_max(self) -> float:
        """Longest time a call of OpenCV should take: opening takes up to two timeouts."""
        return 3 * call_seconds_max(self._patient)

    def close(self) -> None:
        """Stop; waits for a blocked read, at most its timeouts."""
        self._stop.set()
        with suppress(queue.Empty):
            self._queue.get_nowait()  # the thread may wait for room
        if self._thread.is_alive():
            self._thread.join(self._blocked_seconds_max)

    # -- the capture thread ------------------------------

    def _run(self) -> None:
        """Connect, read, and reconnect after a delay, until stopped."""
        wait = HEARTBEAT_SECONDS
        while not self._stop.is_set():
            self._ffmpeg_log.newest_reason()  # discard those of an earlier connection

            manner = self._patient, self._bare_jpeg
            reason = self._connection()
            if self._stop.is_set():
                return

            # Wait with jitter; the delay doubles unless there were frames.
            self.failures += 1
            if self.state == "running":
                wait = HEARTBEAT_SECONDS
            pause = wait * random.uniform(0.5, 1.0)
            is_lost = (self._patient, self._bare_jpeg) <= manner
            self._lose(f"{reason}{RETRY_SEPARATOR}{pause:.1f} s", is_lost)
            wait = min(2 * wait, BACKOFF_SECONDS_MAX)
            self._stop.wait(pause)

    def _connection(self) -> str:
        """Open the source and read it until it dies; return the reason.

        `_call_start` marks the begin of each call that may block.
        """
        self._call_start = time.monotonic()
        capture = Capture(
            self._source,
            self._settings,
            self._colour,
            self._ffmpeg_log,
            self._patient,
            self._bare_jpeg,
        )
        try:
            if not capture.is_open:
                reason = why_not_opened(self._source, self._ffmpeg_log)
                return f"the source cannot be opened: {reason}"
            self.connections += 1
            return no_stream(self._source, capture, 0, StampClock()) or self._read(capture)
        finally:
            self._call_start = time.monotonic()
            capture.release()
            self._call_start = None

    def _read(self, capture: Capture) -> str:
        """Pass frames on until the source dies; return the reason."""
        clock = StampClock()
        selector = FrameSelector(self._settings.analysed_fps)
        self._playback.begin()
        self.observation = Observed(capture, self._settings)
        held_frames: list[tuple[float, float, Frame]] = []
        start = last_decode = time.monotonic()
        frames = 0
        moment = float("-inf")
        while not self._stop.is_set():
            # Grab a frame.
            self._call_start = call_start = time.monotonic()
            stamp = capture.grab()
            arrival = time.monotonic()
            if stamp is None:
                return self._why_ended(
                    capture, clock, frames, arrival - call_start, last_decode - start
                )
            if not frames:
                start = last_decode = arrival
            frames += 1
            self.frames_grabbed += 1

            # Decode it if it is to be analysed.
            clock.record(stamp, arrival)
            moment = max(moment, clock.captured(stamp, arrival) or arrival)
            frame = None
            if selector.wants(moment):
                frame = capture.frame()
                if frame is not None:
                    last_decode = arrival
                    if self._playback.repeats(arrival, frame.luma) and is_rtsp(self._source):
                        return RTSP_RECORDING
                    held_frames.append((stamp, arrival, frame))
                else:
                    self.frames_dropped += 1
                    if arrival - last_decode > CALL_SECONDS_MAX:
                        self._lose(f"frames come, none can be decoded: {capture.fault}")

            # Hold it until the clock has settled, then pass it on with its capture time.
            if arrival - start < SETTLE_SECONDS:
                continue
            self.observation.add(arrival, None if frame is None else frame.luma)
            if held_frames:
                self.state = "running"
                self.reason = "; ".join(self.observation.remarks)
                self.is_lost = False
                for held_frame in held_frames:
                    self._hand_on(clock, *held_frame)
                held_frames.clear()
        return "closed"

    def _why_ended(
        self,
        capture: Capture,
        clock: StampClock,
        frames: int,
        wait_seconds: float,
        run_seconds: float,
    ) -> str:
        """Return why a connection gives no frame any more, and note how to open the next one.

        frames: number of its frames.
        wait_seconds: time that the last call took, seconds.
        run_seconds: time from its first frame to the last one that was decoded, seconds.
        """
        timed_out = wait_seconds > call_seconds_max(self._patient) / 2
        is_short = run_seconds < OBSERVED_SECONDS
        if capture.is_jpeg and scheme_of(self._source).startswith("http") and not timed_out:
            self._bare_jpeg = is_short if not self._bare_jpeg else frames > 0
            if self._bare_jpeg and not frames:
                return "its pictures are not marked as JPEG: searching for them"
        else:
            self._patient |= (timed_out and is_short) or (not frames and capture.size == (0, 0))
        if not frames:
            return f"it opens, but gives no picture: {no_frame(capture)}"
        if timed_out:
            return "no frame within the read timeout"
        return (
            no_stream(self._source, capture, frames, clock)
            or "the source ended or closed the connection"
        )

    def _lose(self, reason: str, is_lost: bool = True) -> None:
        """Say that there are no frames, or none any more.

        is_lost: more patience does not help.
        """
        self.is_lost = is_lost
        self.state = "stalled" if self._latest > float("-inf") else "connecting"
        self.reason = reason.removesuffix(": ")

    def _hand_on(self, clock: StampClock, stamp: float, arrival: float, frame: Frame) -> None:
        """Queue a frame with its capture time, unless that is not later than the last one's.

        If the queue is full, a frame of a burst waits for as long as it came late, as the next
        burst takes as long to come; then it is dropped.
        """
        capture_t = clock.captured(stamp, arrival)
        self.untrusted_stamps += capture_t is None
        t = capture_t or arrival
        if t <= self._latest or self._stop.is_set():  # no reader is left
            self.frames_dropped += 1
            return
        self._latest = t
        shift = self._wall_clock() - time.monotonic() - self._ahead
        if abs(shift - self._shift) > PROMPT_SECONDS:  # capture times are no more exact
            self._shift = shift
        frame = frame._replace(t=t + self._ahead, shift=self._shift)
        self._call_start = None
        try:
            self._queue.put(frame, timeout=arrival - t)
        except queue.Full:
            self.frames_dropped += 1
