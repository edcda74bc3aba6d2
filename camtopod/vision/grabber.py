"""One camera: pixels in, entry and exit events out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Literal

from camtopod.records import Event
from camtopod.vision.pipeline import Watcher
from camtopod.vision.settings import VisionSettings
from camtopod.vision.source import Complaints, LiveSource, RecordedSource, kind_of

State = Literal["connecting", "running", "stalled", "ended"]

HEARTBEAT_SECONDS = 0.5
"""`Grabber.events` gives control back at least this often (a single slow frame aside)."""


class Grabber:
    """Watches one source and says who appears in its view and who leaves it.

    ``source`` is an ``rtsp://`` (or other) URL, the path of a video file, or a device number as
    text. A file is read as fast as it decodes and its times are ``start`` + position in the file;
    with ``realtime`` it is paced at ``speed`` times its own rate (times stay ``start`` + position).
    A stream's or device's times are capture times on the clock ``wall_clock`` (seconds since the
    epoch).

    One grabber per process for network streams: OpenCV serialises opens inside a process and its
    FFmpeg options are process-wide. Not thread-safe: all calls from one thread. Raises `OSError`
    (`SourceError` among them) if a *file* cannot be read or decoded; a stream that is not there yet
    is waited for.
    """

    def __init__(
        self,
        camera: str,
        source: str,
        *,
        start: float = 0.0,
        realtime: bool = False,
        speed: float = 1.0,
        wall_clock: Callable[[], float],
        settings: VisionSettings | None = None,
        complaints: Complaints | None = None,
    ) -> None:
        settings = settings or VisionSettings()
        self.camera = camera
        self._source: RecordedSource | LiveSource
        if kind_of(source) == "file":
            path = source.removeprefix("file://")
            self._source = RecordedSource(path, settings, start, speed if realtime else None)
        else:
            self._source = LiveSource(source, settings, wall_clock, complaints)
        self._watcher = Watcher(camera, settings)
        self._analysis_seconds = 0.0
        self._last_t: float | None = None

    def events(self) -> Iterator[Event | None]:
        """Yield events as they become certain, and ``None`` at least about once a second so that
        the caller can act.

        Entries come once the object is confirmed, exits after the tracker's patience; ``t`` is the
        capture time of the first or last sighting, so events come up to some seconds late and not
        quite in order of ``t``. No ``boot``, no ``seq``: the publisher adds them. Ends after the
        last frame of a file; never for a stream or device (after `close`, it does). Raises
        `SourceError` if a *file* turns out to hold no frame.
        """
        heard = time.monotonic()
        for frame in self._source.frames():
            events: list[Event] = []
            if frame is not None:
                began = time.thread_time()
                events = self._watcher.see(frame.t, frame.luma)
                self._analysis_seconds += time.thread_time() - began
                self._last_t = frame.t
            yield from events
            now = time.monotonic()
            if events:
                heard = now
            elif frame is None or now - heard >= HEARTBEAT_SECONDS:
                heard = now
                yield None
        yield from self._watcher.finish()

    @property
    def state(self) -> State:
        """``connecting`` (not one frame yet), ``running``, ``stalled`` (it worked before;
        reconnecting), ``ended``."""
        return self._source.state

    @property
    def reason(self) -> str:
        """A short sentence for a person saying why the state is not ``running``; "" if it is. Holds
        no password."""
        return self._source.reason

    @property
    def overdue_seconds(self) -> float:
        """How much longer than its timeouts allow the source has been in one call of OpenCV; 0.0 if
        all is well.

        Nothing but ending the process helps against that.
        """
        return self._source.overdue_seconds

    def statistics(self) -> dict[str, int | float]:
        """Counters since the start; ``last_frame_t`` is the capture time of the latest frame
        (absent before it)."""
        source = self._source
        figures: dict[str, int | float] = {
            "frames_grabbed": source.grabbed,
            "frames_dropped": source.dropped,
            "connections": source.connections,
            "failures": source.failures,
            "untrusted_stamps": source.untrusted_stamps,
            "analysis_cpu_seconds": round(self._analysis_seconds, 3),
            **self._watcher.statistics(),
        }
        if self._last_t is not None:
            figures["last_frame_t"] = self._last_t
        return figures

    def close(self) -> None:
        """Release the source; `events` then ends. A stream's blocked read is waited for, at most
        its timeouts."""
        self._source.close()
