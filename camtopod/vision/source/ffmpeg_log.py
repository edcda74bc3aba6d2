"""Why a stream cannot be opened, which OpenCV does not tell: FFmpeg says it, and OpenCV prints it
to standard output.

Only what is recognised is handed on, in our words: FFmpeg's own may hold addresses and passwords.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager

LEVEL_VARIABLE = "OPENCV_FFMPEG_LOGLEVEL"
LEVEL_WARNINGS = "24"
_READ_BYTES = 65536
_LIBC = ctypes.CDLL(None)
_STANDARD_OUTPUT = 1
_REFUSED = re.compile(rb"(?:failed: (?:Server returned )?|HTTP error )([45]\d\d)\b")
_STATUSES = {
    401: "the camera refuses the user name or password",
    403: "the camera refuses the user name or password",
    404: "the camera has no such stream",
    454: "the camera has ended the session",
    453: "the camera has too many viewers",
    503: "the camera is busy",
}
_PHRASES = {
    b"Connection refused": "nothing listens at this address and port",
    b"Failed to resolve hostname": "the host's name is not known",
    b"No route to host": "there is no way to the host",
    b"Network is unreachable": "there is no way to the host",
    b"Connection timed out": "the host does not answer",
    b"Immediate exit requested": "the host does not answer",
    b"End of file": "the host closes the connection: is it a camera's port?",
    b"Connection reset": "the host closes the connection: is it a camera's port?",
}


def reason_in(said: bytes) -> str:
    """The last reason in what FFmpeg said; "" if none is recognised."""
    for line in reversed(said.splitlines()):
        refused = _REFUSED.search(line)
        if refused is not None:
            status = int(refused.group(1))
            return f"{_STATUSES.get(status, 'the camera refuses')} ({status})"
        for phrase, words in _PHRASES.items():
            if phrase in line:
                return words
    return ""


class Complaints:
    """What has been said since it was asked last; nothing unless `listening`."""

    def __init__(self, fd: int | None = None) -> None:
        self._fd = fd

    def take(self) -> str:
        """The newest reason, or "". Never blocks."""
        if self._fd is not None:
            _flush()
        said = b""
        while self._fd is not None:
            try:
                heard = os.read(self._fd, _READ_BYTES)
            except BlockingIOError:
                break
            if not heard:  # nobody can say anything any more
                break
            said = (said + heard)[-_READ_BYTES:]
        return reason_in(said)


def _flush() -> None:
    """What OpenCV has printed waits in the buffer of C's standard output, a thing apart from
    `sys.stdout`.
    """
    _LIBC.fflush(None)


@contextmanager
def _log_level(level: str) -> Iterator[None]:
    """FFmpeg's log has this level if it is opened first while the block runs; one that the user has
    set stays.

    Afterwards the environment is as before: a process that is started then decides for itself.
    """
    if LEVEL_VARIABLE in os.environ:
        yield
        return
    os.environ[LEVEL_VARIABLE] = level
    try:
        yield
    finally:
        del os.environ[LEVEL_VARIABLE]


@contextmanager
def listening() -> Iterator[Complaints]:
    """Standard output is FFmpeg's while the block runs; a program with data for it duplicates the
    descriptor before.
    """
    sys.stdout.flush()
    _flush()
    heard, written = os.pipe()
    for fd in (heard, written):
        os.set_blocking(fd, False)  # when it is full, what is said is lost, and nothing waits
    before = os.dup(_STANDARD_OUTPUT)
    os.dup2(written, _STANDARD_OUTPUT, inheritable=False)
    os.close(written)
    try:
        with _log_level(LEVEL_WARNINGS):
            yield Complaints(heard)
    finally:
        _flush()  # or it would come among what is printed next
        os.dup2(before, _STANDARD_OUTPUT)
        os.close(before)
        os.close(heard)
