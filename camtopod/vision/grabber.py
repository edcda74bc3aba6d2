"""One camera: pixels in, entry and exit events out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Literal

from camtopod.records import Event
from camtopod.vision.settings import VisionSettings

State = Literal["connecting", "running", "stalled", "ended"]


class Grabber:
    """Watches one source and says who appears in its view and who leaves it.

    ``source`` is an ``rtsp://`` (or other) URL, the path of a video file, or a device number as text. A file is read
    as fast as it decodes and its times are ``start`` + position in the file; with ``realtime`` it is paced at
    ``speed`` times its own rate (times stay ``start`` + position). A stream's or device's times are capture times on
    the clock ``wall_clock`` (seconds since the epoch).

    One grabber per process for network streams: OpenCV serialises opens inside a process and its FFmpeg options are
    process-wide. Not thread-safe: all calls from one thread, as releasing a capture while it reads crashes.
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
    ) -> None:
        self.camera = camera
        self.source = source
        self._start = start
        self._speed = speed if realtime else None
        self._wall_clock = wall_clock
        self._settings = settings or VisionSettings()
        self._state: State = "connecting"
        self._reason = ""

    def events(self) -> Iterator[Event | None]:
        """Yield events as they become certain, and ``None`` at least about once a second so that the caller can act.

        Entries come once the object is confirmed, exits after the tracker's patience; ``t`` is the capture time of
        the first or last sighting, so events come up to some seconds late and not quite in order of ``t``. No
        ``boot``, no ``seq``: the publisher adds them. Ends after the last frame of a file; never for a stream or
        device. Raises `FileNotFoundError` or `SourceError` if a *file* cannot be read at all.
        """
        raise NotImplementedError

    @property
    def state(self) -> State:
        """``connecting`` (not one frame yet), ``running``, ``stalled`` (it worked before; reconnecting), ``ended``."""
        return self._state

    @property
    def reason(self) -> str:
        """A short sentence for a person saying why the state is not ``running``; "" if it is. Holds no password."""
        return self._reason

    def statistics(self) -> dict[str, int | float]:
        """Counters since the start: frames grabbed and analysed, connections, entries, exits, ... and ages."""
        raise NotImplementedError

    def close(self) -> None:
        """Release the source. Call it from the thread that iterates ``events()``."""
        raise NotImplementedError
