"""Find out why a stream cannot be opened, from FFmpeg's log.

OpenCV does not report the reason; FFmpeg logs it, and OpenCV prints that to standard output. Only
recognised reasons are passed on, in our own words: FFmpeg's may contain addresses and passwords.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

LEVEL_VARIABLE = "OPENCV_FFMPEG_LOGLEVEL"
LEVEL_WARNINGS = "24"
"""FFmpeg's number for the log level "warning"."""
_READ_BYTES = 65536
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
}
"""Reason by phrase in FFmpeg's log."""


def reason_in(output: bytes) -> str:
    """Return the last recognised reason in FFmpeg's output; "" if there is none."""
    for line in reversed(output.splitlines()):
        refused = _REFUSED.search(line)
        if refused is not None:
            status = int(refused.group(1))
            return f"{_STATUSES.get(status, 'the camera refuses')} ({status})"
        for phrase, words in _PHRASES.items():
            if phrase in line:
                return words
    return ""


class FfmpegLog:
    """FFmpeg's output since the last query; empty unless created by `captured_log`."""

    def __init__(self, fd: int | None = None) -> None:
        self._fd = fd

    def newest_reason(self) -> str:
        """Return the newest reason, or "". Never blocks."""
        if self._fd is None:
            return ""
        _LIBC.fflush(None)
        output = b""
        with suppress(BlockingIOError):
            while chunk := os.read(self._fd, _READ_BYTES):  # nothing: the pipe has been closed
                output = (output + chunk)[-_READ_BYTES:]
        return reason_in(output)


@contextmanager
def default_environment(name: str, value: str) -> Iterator[None]:
    """Set a variable of the environment, which OpenCV reads, while the block runs.

    A value that the user has set takes precedence. The environment is restored afterwards, so it
    does not affect child processes.
    """
    if not value or name in os.environ:
        yield
        return
    os.environ[name] = value
    try:
        yield
    finally:
        del os.environ[name]


@contextmanager
def captured_log() -> Iterator[FfmpegLog]:
    """Redirect standard output to a pipe, for FFmpeg's log, while the block runs.

    A program that writes data to standard output duplicates the descriptor first.
    """
    sys.stdout.flush()
    _LIBC.fflush(None)
    reader, writer = os.pipe()
    for fd in (reader, writer):
        os.set_blocking(fd, False)  # a full pipe loses output instead of blocking

    # Redirect standard output; the descriptor is restored at the end.
    before = os.dup(_STANDARD_OUTPUT)
    os.dup2(writer, _STANDARD_OUTPUT, inheritable=False)
    os.close(writer)
    try:
        with default_environment(LEVEL_VARIABLE, LEVEL_WARNINGS):
            yield FfmpegLog(reader)
    finally:
        _LIBC.fflush(None)  # or its output would mix with what is printed next
        os.dup2(before, _STANDARD_OUTPUT)
        os.close(before)
        os.close(reader)
