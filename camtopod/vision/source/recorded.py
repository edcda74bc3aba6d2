"""Frames of a video file, as fast as it decodes or at its own pace."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

from camtopod.vision.settings import VisionSettings
from camtopod.vision.source.capture import Capture, Frame, FrameSelector, Source

FPS_UNKNOWN = 25.0
"""Frame rate assumed if a file has neither time stamps nor a frame rate."""
HEARTBEAT_SECONDS = 0.5
"""Longest time until `RecordedSource.frames` yields while it waits."""


class SourceError(OSError):
    """A video file exists but cannot be decoded, or holds no frame.

    ``str()`` names the file, without a password.
    """


class RecordedSource(Source):
    """A video file. Capture times are ``start`` plus the position in the file, seconds."""

    def __init__(
        self,
        path: str,
        settings: VisionSettings,
        start: float,
        realtime: bool,
        colour: bool = False,
    ) -> None:
        """Open the file.

        realtime: read at the file's own pace, not as fast as it decodes.
        colour: frames have an image in colour.

        Raises `OSError`, `SourceError`.
        """
        with open(path, "rb") as file:  # reports why it cannot be read, which OpenCV does not
            if os.fstat(file.fileno()).st_size == 0:
                raise SourceError(f"{path}: the file is empty")
        self._path = path
        self._settings = settings
        self._start = start
        self._realtime = realtime
        self._capture: Capture | None = Capture(path, settings, colour)
        if not self._capture.is_open:
            self.close()
            raise SourceError(f"{path}: not a video this program can decode")
        self.reason = "not read yet"
        self.connections = 1
        self.overdue_seconds = 0.0
        """Always 0.0: the caller is the reader and cannot ask while a call of OpenCV lasts."""

    def frames(self) -> Iterator[Frame | None]:
        """Yield the frames to analyse, or None while waiting.

        Raises `SourceError` if the file holds no frame.
        """
        selector = FrameSelector(self._settings.analysed_fps)
        began = time.monotonic()
        position = 0.0
        while self._capture is not None:
            stamp = self._capture.grab()
            if stamp is None:
                break
            position = self._position(stamp, position)
            self.grabbed += 1
            self.state = "running"
            self.reason = ""
            if not selector.wants(position):
                continue

            frame = self._capture.frame()
            if frame is None:
                self.dropped += 1
                continue
            if self._realtime:
                yield from _until(began + position)
            yield frame._replace(t=self._start + position)

        self.close()
        if not self.grabbed:
            raise SourceError(f"{self._path}: no frame in it can be decoded")
        self.state = "ended"
        self.reason = "the file is at its end"

    def _position(self, stamp: float, last: float) -> float:
        """Return the position in seconds, by the frame rate where stamps do not increase."""
        if not self.grabbed:
            return max(0.0, stamp)
        if stamp > last:
            return stamp
        self.untrusted_stamps += 1
        assert self._capture is not None
        return last + 1.0 / (self._capture.fps or FPS_UNKNOWN)

    def close(self) -> None:
        """Release the file."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None


def _until(due: float) -> Iterator[None]:
    """Sleep until ``due`` on the monotonic clock, yielding None now and then."""
    while (remaining := due - time.monotonic()) > 0:
        time.sleep(min(remaining, HEARTBEAT_SECONDS))
        if remaining > HEARTBEAT_SECONDS:
            yield None
