"""Grabber: one camera's pixels in, entry and exit events out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from typing import Literal

from msgspec.structs import replace

from camtopod.records import Event
from camtopod.vision.detector.detector import Detector
from camtopod.vision.pipeline import Observer, ViewPipeline
from camtopod.vision.settings import VisionSettings
from camtopod.vision.source import (
    HEARTBEAT_SECONDS,
    NO_LOG,
    NO_OPTIONS,
    FfmpegLog,
    FileOptions,
    LiveSource,
    RecordedSource,
    State,
    kind_of,
)


class Grabber:
    """Entry and exit events of one source.

    source: an ``rtsp://`` (or other) URL, the path of a video file, or a device number as text.
    file_options: how a file is read.
    wall_clock: current time in seconds since the epoch. Frames of a stream or device have capture
        times on this clock.
    observer: called with every analysed frame, within `events`; the events do not depend on it.
    detector: finds people in moving regions; None: motion alone.

    Use one grabber per process for network streams: OpenCV serialises opening within a process, and
    its FFmpeg options are process-wide. Not thread-safe.

    Raises `OSError` (including `SourceError`) if a *file* cannot be read or decoded. A stream that
    is not available yet is waited for.
    """

    def __init__(
        self,
        camera: str,
        source: str,
        *,
        wall_clock: Callable[[], float],
        file_options: FileOptions = NO_OPTIONS,
        settings: VisionSettings | None = None,
        ffmpeg_log: FfmpegLog = NO_LOG,
        observer: Observer | None = None,
        detector: Detector | None = None,
    ) -> None:
        settings = settings or VisionSettings()
        self.camera = camera
        self._source: RecordedSource | LiveSource
        if kind_of(source) == "file":
            self._source = RecordedSource(
                source, settings, file_options, detector is not None, ffmpeg_log
            )
        else:
            self._source = LiveSource(
                source, settings, wall_clock, ffmpeg_log, detector is not None
            )
        self._pipeline = ViewPipeline(camera, settings, observer, detector)
        self._analysis_seconds = 0.0
        self._last_t: float | None = None
        self._shifts = (0.0, 0.0)
        """By how much the wall clock was shifted until it was set last, and since, seconds."""
        self._set_at = 0.0
        """Capture time from which on the latter holds."""

    def events(self) -> Iterator[Event | None]:
        """Yield events as they become certain, and None at least about once a second.

        None lets the caller act while nothing happens. An entry is yielded once its object is
        confirmed, an exit after the tracker's patience. As ``t`` is the capture time of the first
        or last sighting, events are up to some seconds late and not strictly in order of ``t``.
        They have no ``boot`` and no ``seq``: the publisher adds them.

        Ends after the last frame of a file; for a stream or device, only after `close`. Raises
        `SourceError` if a *file* turns out to hold no frame.
        """
        yielded_at = time.monotonic()
        for frame in self._source.frames():
            events: list[Event] = []

            if frame is not None:
                start = time.thread_time()
                if frame.shift != self._shifts[1]:
                    self._shifts = (self._shifts[1], frame.shift)
                    self._set_at = frame.t
                events = self._pipeline.process(frame.t, frame.luma, frame.image)
                self._analysis_seconds += time.thread_time() - start
                self._last_t = frame.t + frame.shift

            # Yield the events, or None if nothing was yielded for the heartbeat interval.
            yield from self._labelled(events)
            now = time.monotonic()
            if events:
                yielded_at = now
            elif frame is None or now - yielded_at >= HEARTBEAT_SECONDS:
                yielded_at = now
                yield None

        # The source has ended.
        yield from self._labelled(self._pipeline.finish())

    def _labelled(self, events: Iterable[Event]) -> Iterator[Event]:
        """Yield events with the time that the wall clock showed then; it may have been set."""
        for event in events:
            yield replace(event, t=event.t + self._shifts[event.t >= self._set_at])

    @property
    def state(self) -> State | Literal["blind"]:
        """State of the source: ``connecting``, ``running``, ``stalled`` or ``ended``; or ``blind``.

        ``connecting``: no frame has arrived yet; ``stalled``: frames arrived before, reconnecting;
        ``blind``: it runs, but nothing can be told from its pictures, so there are no events.
        """
        state = self._source.state
        return "blind" if state == "running" and self._pipeline.reason else state

    @property
    def reason(self) -> str:
        """Readable reason why the state is not ``running``, or what could be better; "" if nothing.

        It contains no password.
        """
        blind_reason = self._pipeline.reason if self.state == "blind" else ""
        return "; ".join(filter(None, (blind_reason, self._source.reason)))

    @property
    def overdue_seconds(self) -> float:
        """Time that a call of OpenCV has exceeded its timeouts by; 0.0 if all is well.

        Only ending the process helps against such a call.
        """
        return self._source.overdue_seconds

    def statistics(self) -> dict[str, int | float | str]:
        """Return counters since the start.

        ``last_frame_t`` is the capture time of the latest frame (absent before the first).
        """
        source = self._source
        figures: dict[str, int | float | str] = {
            "frames_grabbed": source.frames_grabbed,
            "frames_dropped": source.frames_dropped,
            "connections": source.connections,
            "failures": source.failures,
            "untrusted_stamps": source.untrusted_stamps,
            "analysis_cpu_seconds": round(self._analysis_seconds, 3),
            **self._pipeline.statistics(),
        }
        if self._last_t is not None:
            figures["last_frame_t"] = self._last_t
        return figures

    def close(self) -> None:
        """Release the source, which ends `events`.

        Waits for a blocked read, at most its timeouts.
        """
        self._source.close()
