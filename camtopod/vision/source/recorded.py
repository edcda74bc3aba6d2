"""Frames of a video file, as fast as it decodes or at its own pace."""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Iterator

from camtopod.vision.settings import VisionSettings
from camtopod.vision.source.capture import Capture, Frame, FrameSelector, Source
from camtopod.vision.source.ffmpeg_log import FfmpegLog
from camtopod.vision.source.source_url import file_path

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
        ffmpeg_log: FfmpegLog | None = None,
    ) -> None:
        """Open the file, of which ``path`` may be the URL.

        realtime: read at the file's own pace, not as fast as it decodes.
        colour: frames have an image in colour.
        ffmpeg_log: tells which frames are damaged or none.

        Raises `OSError`, `SourceError`.
        """
        ffmpeg_log = ffmpeg_log or FfmpegLog()
        if why := _no_file(path):
            raise SourceError(f"{path}: {why}")
        self._path = path
        self._settings = settings
        self._start = start
        self._realtime = realtime
        self._capture: Capture | None = Capture(path, settings, colour, ffmpeg_log)
        if not self._capture.is_open:
            self.close()
            why = ffmpeg_log.newest_reason()
            raise SourceError(f"{path}: not a video this program can decode{why and ': '}{why}")
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
            if not selector.wants(position):
                continue

            frame = self._capture.frame()
            if frame is None:
                self.dropped += 1
                continue
            self.state = "running"
            self.reason = ""
            if self._realtime:
                yield from _until(began + position)
            yield frame._replace(t=self._start + position)

        if self._capture is not None and self.state == "connecting":
            codec, why = self._capture.codec, self._capture.fault
            self.close()
            raise SourceError(
                f"{self._path}: no frame in it can be decoded ({codec}){why and ': '}{why}"
            )
        self.close()
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


def _no_file(source: str) -> str:
    """Return why a source is no file with a video; "" if it may be one.

    Raises `OSError` if it cannot be read, with the reason, which OpenCV does not tell.
    """
    if source == "-":
        return "standard input cannot be read: write the video to a file first"
    path = file_path(source)
    found = os.stat(path)
    if stat.S_ISFIFO(found.st_mode) or stat.S_ISSOCK(found.st_mode):
        return "a pipe cannot be read: write the video to a file first"
    if stat.S_ISCHR(found.st_mode) or stat.S_ISBLK(found.st_mode):
        return "not a video device: a camera is /dev/video0 or 0, for example"
    with open(path, "rb"):
        return "" if found.st_size else "the file is empty"


def _until(due: float) -> Iterator[None]:
    """Sleep until ``due`` on the monotonic clock, yielding None now and then."""
    while (remaining := due - time.monotonic()) > 0:
        time.sleep(min(remaining, HEARTBEAT_SECONDS))
        if remaining > HEARTBEAT_SECONDS:
            yield None
