"""Frames of a video file, as fast as it decodes or at its own pace."""

from __future__ import annotations

import fcntl
import re
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from camtopod.vision.settings import VisionSettings
from camtopod.vision.source.capture import HEARTBEAT_SECONDS, Capture, Frame, FrameSelector, Source
from camtopod.vision.source.ffmpeg_log import NO_LOG, FfmpegLog
from camtopod.vision.source.file_times import FileTimes
from camtopod.vision.source.remarks import Observed
from camtopod.vision.source.source_url import file_path

FAILURES_MAX = 10_000
"""Failures to read a frame, on end, before a file has ended: some minutes of damage."""


class SourceError(OSError):
    """A video file exists but cannot be decoded, or holds no frame.

    ``str()`` names the file, without a password.
    """


class FileOptions(NamedTuple):
    """How a file is read.

    start (Unix seconds): time of its beginning; capture times are ``start`` + position.
    realtime: at its own pace, not as fast as it decodes; capture times do not depend on it.
    """

    start: float = 0.0
    realtime: bool = False


NO_OPTIONS = FileOptions()
"""A file that began at time 0, as fast as it decodes."""


class RecordedSource(Source):
    """A video file."""

    def __init__(
        self,
        path: str,
        settings: VisionSettings,
        file_options: FileOptions = NO_OPTIONS,
        colour: bool = False,
        ffmpeg_log: FfmpegLog = NO_LOG,
    ) -> None:
        """Open the file, of which ``path`` may be the URL.

        colour: frames have an image in colour.
        ffmpeg_log: tells which frames are damaged or none.

        Raises `OSError`, `SourceError`.
        """
        if reason := _no_file(path):
            raise SourceError(f"{path}: {reason}")
        self._path = path
        self._selector = FrameSelector(settings.analysed_fps)
        self._file_options = file_options
        self._capture = Capture(path, settings, colour, ffmpeg_log)
        if not self._capture.is_open:
            self.close()
            reason = "; ".join(filter(None, (ffmpeg_log.newest_reason(), _unfinished(path))))
            raise SourceError(
                f"{path}: not a video this program can decode{reason and ': '}{reason}"
            )
        self._times = FileTimes(self._capture.fps)
        self._declared_seconds = 0.0
        """Duration that the file declares, 0.0 if unknown."""
        self.observation = Observed(self._capture, settings)
        self.reason = "not read yet"
        self.connections = 1
        self.overdue_seconds = 0.0
        """Always 0.0: the caller is the reader and cannot ask while a call of OpenCV lasts."""

    def frames(self) -> Iterator[Frame | None]:
        """Yield the frames to analyse, or None while waiting.

        What cannot be read is passed over, up to the declared end. Raises `SourceError` if no frame
        of the file can be decoded.
        """
        held_frames: list[Frame | None] = []
        """Frames whose positions are not known yet; None for those that are not analysed."""
        failures = 0
        start = time.monotonic()
        while self._capture.is_open and failures <= FAILURES_MAX:
            stamp = self._capture.grab()
            if stamp is None:
                failures += 1
                continue
            self.frames_dropped += failures
            failures = 0
            self.frames_grabbed += 1
            if self.frames_grabbed == 1:
                self._declared_seconds = self._capture.seconds

            # Decode it if it is to be analysed, and yield it when its position is known.
            positions = self._times.place(stamp)
            held_frames.append(None)
            if self._selector.wants(self._times.latest):
                held_frames[-1] = self._capture.frame()
                self.frames_dropped += held_frames[-1] is None
            if positions:
                yield from self._placed(held_frames, positions, start)
                held_frames.clear()

        yield from self._placed(held_frames, self._times.rest(), start)
        if self._capture.is_open:
            self._end()

    def _placed(
        self, frames: list[Frame | None], positions: list[float], start: float
    ) -> Iterator[Frame | None]:
        """Yield frames with their positions, in real time if that was asked for."""
        self.untrusted_stamps = self._times.untrusted_count
        for frame, position in zip(frames, positions, strict=True):
            self.observation.add(position, None if frame is None else frame.luma)
            if frame is not None:
                self.state = "running"
                self.reason = "; ".join(self.observation.remarks)
                if self._file_options.realtime:
                    yield from _until(start + position)
                yield frame._replace(t=self._file_options.start + position)

    def _end(self) -> None:
        """Say how much was read. Raises `SourceError` if that was nothing."""
        fault = self._capture.fault
        if self.state == "connecting":
            reason = f"no frame in it can be decoded ({self._capture.codec}){fault and ': '}{fault}"
            raise SourceError(f"{self._path}: {reason}")
        self.state = "ended"
        read_seconds = self._times.latest + self._times.interval
        if not self.observation.fps:
            self.observation.judge()
        end = max(read_seconds, self._declared_seconds)
        faults = "; ".join(
            filter(
                None,
                [
                    "the video ends early, or begins late"
                    if end > read_seconds + self._times.gap
                    else "",
                    fault if self.frames_dropped else "",
                    *self.observation.remarks,
                    f"it has no time stamps, so {1.0 / self._times.interval:.3g} frames a second "
                    "are assumed; if that is wrong: ffmpeg -r RATE -i FILE -c copy film.mp4"
                    if self._times.is_unstamped
                    else "",
                    f"{self.untrusted_stamps} time stamps not believed"
                    if self.untrusted_stamps
                    else "",
                    _unfinished(self._path),
                ],
            )
        )
        self.reason = f"{read_seconds:.1f} s of {end:.1f} s read{faults and f' ({faults})'}"

    def close(self) -> None:
        """Release the file."""
        self._capture.release()


def _no_file(source: str) -> str:
    """Return why a source is no file with a video; "" if it may be one.

    Raises `OSError` if it cannot be read, with the reason, which OpenCV does not tell.
    """
    if source == "-":
        return "standard input cannot be read: write the video to a file first"
    path = Path(file_path(source))
    if path.is_fifo() or path.is_socket():
        return "a pipe cannot be read: write the video to a file first"
    if path.is_char_device() or path.is_block_device():
        return "not a video device: a camera is /dev/video0 or 0, for example"
    advice = "make a video of its pictures first: ffmpeg -framerate 25 -i %04d.jpg film.mp4"
    if path.is_dir():
        return f"a directory cannot be read: give a file in it, or {advice}"
    if not path.exists() and re.search(r"%\d*d|[*?]", path.name):
        return f"a picture sequence cannot be read: {advice}"
    with path.open("rb") as file:
        if file.read(1):
            return ""
    return "; ".join(filter(None, ("the file is empty", _unfinished(source))))


def _unfinished(source: str) -> str:
    """Return a remark on a file that a program has open for writing: Linux then refuses a lease.

    "" if there is none, or it is not known, as of another user's file or one on a network.
    """
    with suppress(OSError), open(file_path(source), "rb") as file:
        fcntl.fcntl(file, fcntl.F_SETSIG, signal.SIGURG)  # a lease that is broken harms nothing
        try:
            fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_RDLCK)
        except BlockingIOError:
            return "it is still being written: read it when that has ended"
    return ""


def _until(due: float) -> Iterator[None]:
    """Sleep until ``due`` on the monotonic clock, yielding None now and then."""
    while (seconds_left := due - time.monotonic()) > 0:
        time.sleep(min(seconds_left, HEARTBEAT_SECONDS))
        yield None
