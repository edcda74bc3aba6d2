"""Frames of a video file, as fast as it decodes or at its own pace."""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Iterator

from camtopod.vision.settings import VisionSettings
from camtopod.vision.source.capture import HEARTBEAT_SECONDS, Capture, Frame, FrameSelector, Source
from camtopod.vision.source.ffmpeg_log import FfmpegLog
from camtopod.vision.source.file_times import FileTimes
from camtopod.vision.source.remarks import OBSERVED_SECONDS, Observed
from camtopod.vision.source.source_url import file_path

FAILURES_MIN = 1000
"""Failures to read a picture, on end, before the end of a file that declares none."""
FAILURES_MAX = 100_000
"""The same in a file that declares so many more pictures: more than an hour of damage."""
EARLY_SECONDS = 1.0
"""Time by which a video may end before the file, whose sound goes on."""


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
        self._times = FileTimes(self._capture.fps)
        self._observed = Observed(self._capture.size)
        self.reason = "not read yet"
        self.connections = 1
        self.overdue_seconds = 0.0
        """Always 0.0: the caller is the reader and cannot ask while a call of OpenCV lasts."""

    def frames(self) -> Iterator[Frame | None]:
        """Yield the frames to analyse, or None while waiting.

        What cannot be read is passed over, up to the declared end. Raises `SourceError` if no frame
        of the file can be decoded.
        """
        selector = FrameSelector(self._settings.analysed_fps)
        times = self._times
        waiting: list[Frame | None] = []
        """Frames whose positions are not known yet; None for those that are not analysed."""
        failures = 0
        began = time.monotonic()
        while self._capture is not None:
            stamp = self._capture.grab()
            if stamp is None:
                failures += 1
                remaining = self._capture.pictures - self.grabbed
                if failures > min(max(FAILURES_MIN, remaining), FAILURES_MAX):
                    break
                continue
            self.dropped += failures
            failures = 0
            self.grabbed += 1

            # Decode it if it is to be analysed, and yield it when its position is known.
            positions = times.place(stamp)
            waiting.append(None)
            if selector.wants(times.latest):
                waiting[-1] = self._capture.frame()
                self.dropped += waiting[-1] is None
            if positions:
                yield from self._placed(waiting, positions, began)
                waiting.clear()

        yield from self._placed(waiting, times.rest(), began)
        if self._capture is not None:
            self._end(self._capture)

    def _placed(
        self, frames: list[Frame | None], positions: list[float], began: float
    ) -> Iterator[Frame | None]:
        """Yield frames with their positions, in real time if that was asked for."""
        self.untrusted_stamps = self._times.untrusted
        for frame, position in zip(frames, positions, strict=True):
            self._observed.add(position, None if frame is None else frame.luma)
            if frame is not None:
                self.state = "running"
                self.reason = self._observed.words
                if self._realtime:
                    yield from _until(began + position)
                yield frame._replace(t=self._start + position)

    def _end(self, capture: Capture) -> None:
        """Say how much was read. Raises `SourceError` if that was nothing."""
        fault = capture.fault
        if self.state == "connecting":
            why = f"no frame in it can be decoded ({capture.codec}){fault and ': '}{fault}"
            raise SourceError(f"{self._path}: {why}")
        self.state = "ended"
        declared = capture.seconds
        read = self._times.latest + self._times.interval
        if read < OBSERVED_SECONDS:
            self._observed.judge()
        notes = [
            "the video ends early, or begins late" if read < declared - EARLY_SECONDS else "",
            fault if self.dropped else "",
            self._observed.words,
            f"{self.untrusted_stamps} time stamps not believed" if self.untrusted_stamps else "",
        ]
        said = "; ".join(filter(None, notes))
        self.reason = f"{read:.1f} s of {max(read, declared):.1f} s read{said and f' ({said})'}"

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
