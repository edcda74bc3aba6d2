"""Find out from FFmpeg's log why a source cannot be opened, and which frames are none.

OpenCV reports neither, and even calls a frame good that FFmpeg could not convert. FFmpeg logs
both, and OpenCV prints that to standard output. Only what is recognised is passed on, in our own
words: FFmpeg's may contain addresses and passwords.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import FileIO

LEVEL_VARIABLE = "OPENCV_FFMPEG_LOGLEVEL"
LEVEL_WARNINGS = "24"
"""FFmpeg's number for the log level "warning"."""
_LIBC = ctypes.CDLL(None)
"""Flushed before FFmpeg's output is read: C's standard output, which is separate from `sys.stdout`,
holds it.
"""
_STANDARD_OUTPUT = 1
_REFUSED = re.compile(rb"(?:failed: (?:Server returned )?|HTTP error )([45]\d\d)\b")
"""HTTP or RTSP status of a refused request, as FFmpeg logs it."""
_STATUSES = {
    401: "the camera refuses the user name or password",
    403: "the camera refuses the user name or password",
    404: "the camera has no such stream",
    454: "the camera has ended the session",
    453: "the camera has too many viewers",
    461: "the camera refuses TCP: for UDP set OPENCV_FFMPEG_CAPTURE_OPTIONS='rtsp_transport;udp'",
    503: "the camera is busy",
}
"""Reason by HTTP or RTSP status."""
_PHRASES = {
    b"Connection refused": "nothing listens at this address and port",
    b"Failed to resolve hostname": "the host name cannot be resolved",
    b"No route to host": "no route to the host",
    b"Network is unreachable": "the network is unreachable",
    b"Connection timed out": "the host does not answer",
    b"Immediate exit requested": "the host does not answer",
    b"End of file": "the host closes the connection: is it a camera's port?",
    b"Connection reset": "the host closes the connection: is it a camera's port?",
    b"moov atom not found": "its recording was not finished, and its index is missing",
}
"""Reason by phrase in FFmpeg's log."""
UNREACHED = frozenset(
    words for words in _PHRASES.values() if not words.startswith("the host closes")
)
"""Reasons after which it is of no use to ask the host."""
DAMAGED = "damaged video"
_FAULTS = {
    "interlaced video cannot be read: make it progressive": rb"Cannot convert interlaced",
    "its frames cannot be converted": rb"Failed initializing scaling|: fmt:.* -> fmt:",
    "there is no decoder for it": rb"support hardware accelerated",
    DAMAGED: rb"damaged|Packet corrupt|RTP: missed|while decoding MB|concealing \d"
    rb"|block unavailable|Invalid NAL|splitting the input|missing picture|Could not find ref"
    rb"|Error constructing|Error at MB|skipped MB|bad vlc|error y=|no frame!",
}
"""Fault of frames by what FFmpeg logs while it decodes or converts them."""


def reason_in(output: bytes) -> str:
    """Return the last recognised reason in FFmpeg's output; "" if there is none."""
    for line in reversed(output.splitlines()):
        if match := _REFUSED.search(line):
            status = int(match.group(1))
            return f"{_STATUSES.get(status, 'the camera refuses')} ({status})"
        if words := next((words for phrase, words in _PHRASES.items() if phrase in line), ""):
            return words
    return ""


class FfmpegLog:
    """FFmpeg's output since the last query; empty unless created by `captured_log`."""

    def __init__(self, pipe: FileIO | None = None) -> None:
        self._pipe = pipe
        self._reason = ""

    def newest_reason(self) -> str:
        """Return the newest reason since the last query for it, or "". Never blocks."""
        self.newest_fault()
        reason = self._reason
        self._reason = ""
        return reason

    def newest_fault(self) -> str:
        """Return what FFmpeg says of the frames since the last query, or "". Never blocks."""
        if self._pipe is None:
            return ""
        _LIBC.fflush(None)
        output = self._pipe.read() or b""
        self._reason = reason_in(output) or self._reason
        return next((words for words, pattern in _FAULTS.items() if re.search(pattern, output)), "")


NO_LOG = FfmpegLog()


@contextmanager
def environment(name: str, value: str) -> Iterator[None]:
    """Set a variable of the environment, which OpenCV reads, while the block runs.

    It is restored afterwards, so child processes do not get it.
    """
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        del os.environ[name]
        if before is not None:
            os.environ[name] = before


@contextmanager
def captured_log() -> Iterator[FfmpegLog]:
    """Redirect standard output to a pipe, for FFmpeg's log, while the block runs.

    A program that writes data to standard output duplicates the descriptor first.
    """
    sys.stdout.flush()
    _LIBC.fflush(None)
    reader, writer = os.pipe2(os.O_NONBLOCK)  # a full pipe loses output instead of blocking

    # Redirect standard output; the descriptor is restored at the end.
    before = os.dup(_STANDARD_OUTPUT)
    os.dup2(writer, _STANDARD_OUTPUT, inheritable=False)
    os.close(writer)
    with FileIO(reader) as pipe, environment(LEVEL_VARIABLE, LEVEL_WARNINGS):
        try:
            yield FfmpegLog(pipe)
        finally:
            _LIBC.fflush(None)  # or its output would mix with what is printed next
            os.dup2(before, _STANDARD_OUTPUT)
            os.close(before)
