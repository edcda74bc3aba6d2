"""Standard streams of a process, which may be closed or a full pipe that nobody reads.

A long-running program must not wait for the reader of its log. Its standard error therefore becomes
a bounded queue with a thread of its own, the only one that may block (`NonBlockingStream`).
"""

from __future__ import annotations

import io
import os
import select
import sys
import threading
from collections import deque

WAITING_CHARACTERS_MAX = 1 << 20
"""Most characters that wait for the reader of standard error; more text is dropped and counted."""
LAST_WORDS_SECONDS = 0.5
"""Time that the end of a process waits for text to be written."""
_PIECE_BYTES = 4096
"""Bytes written at a time."""
_LOOK_SECONDS = 0.2
"""Time to wait for a non-blocking descriptor to become writable."""
_NUMBERS = (0, 1, 2)
"""File descriptors of the standard streams."""


def open_missing() -> None:
    """Open the null device in place of closed standard streams.

    Otherwise the next opened file would take their number. Standard input and output then fail with
    EBADF when used, as they would without this; standard error does not, as there is no other place
    for messages.
    """
    modes = {0: os.O_WRONLY, 1: os.O_RDONLY, 2: os.O_WRONLY}
    for number in _NUMBERS:
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, modes[number])  # gets the lowest free number
            os.set_inheritable(number, True)
    sys.stdin = sys.stdin or os.fdopen(0, "r", closefd=False)
    sys.stdout = sys.stdout or os.fdopen(1, "w", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", errors="backslashreplace", closefd=False)


class NonBlockingStream(io.TextIOBase):
    """Text stream to the file descriptor ``fd`` whose `write` never blocks; thread-safe."""

    def __init__(self, fd: int, characters_max: int = WAITING_CHARACTERS_MAX) -> None:
        self._fd, self._characters_max = fd, characters_max
        self._changed = threading.Condition()
        self._texts: deque[str] = deque()
        self._waiting = 0
        """Characters that are queued or being written."""
        self._dropped = 0
        threading.Thread(target=self._work, name="standard-error", daemon=True).start()

    def write(self, text: str) -> int:
        """Queue ``text``; drop it if too much is waiting."""
        with self._changed:
            if self._waiting + len(text) > self._characters_max:
                self._dropped += 1
            elif text:
                missing = (
                    f"warning: {self._dropped} messages are missing here: "
                    "standard error was not read\n"
                )
                self._texts.append(missing + text if self._dropped else text)
                self._dropped, self._waiting = 0, self._waiting + len(self._texts[-1])
                self._changed.notify_all()
        return len(text)

    def writable(self) -> bool:
        """Return True: text can always be written."""
        return True

    def fileno(self) -> int:
        """Return the file descriptor."""
        return self._fd

    def isatty(self) -> bool:
        """Return True if the descriptor is a terminal."""
        return os.isatty(self._fd)

    def settle(self, seconds: float = LAST_WORDS_SECONDS) -> bool:
        """Wait until everything has been written; return False if that takes over ``seconds``."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._waiting, seconds)

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: bool(self._texts))
                text = self._texts.popleft()
            _write_all(self._fd, text)
            with self._changed:
                self._waiting -= len(text)
                self._changed.notify_all()


def settle(seconds: float = LAST_WORDS_SECONDS) -> bool:
    """Wait until standard error has been written; return False if nothing reads it."""
    return not isinstance(sys.stderr, NonBlockingStream) or sys.stderr.settle(seconds)


def _write_all(fd: int, text: str) -> None:
    """Write ``text``, waiting for the reader; text to a reader that has gone is lost."""
    data = text.encode("utf-8", "backslashreplace")
    while data:
        try:
            data = data[os.write(fd, data[:_PIECE_BYTES]) :]
        except BlockingIOError:  # another process may have made it non-blocking
            select.select([], [fd], [], _LOOK_SECONDS)
        except OSError:
            return
