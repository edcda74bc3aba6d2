"""A camera's process tells the one above it, or systemd, that its work gets on; lines of JSON
through a pipe.
"""

from __future__ import annotations

import os
import time

import msgspec
from msgspec import Struct

from camtopod.redact import redact
from camtopod.serve.runtime import systemd

REASON_CHARACTERS_MAX = 300
_READ_BYTES = 65536


class Said(Struct, frozen=True):
    """What a camera's process says of itself."""

    state: str
    reason: str
    daemon: str | None = None
    """Why the daemon is not reached; "" if it is, None where that is not known yet."""


class Heart:
    """In the camera's process: `beat` at every turn of the loop that reads frames, as long as that
    gets on.
    """

    def __init__(self, fd: int | None) -> None:
        """``fd``: the end of the pipe to write to, from the process above; None: there is only
        systemd.
        """
        self._fd = fd
        self._said = Said("", "")
        self._next = 0.0
        if fd is not None:
            os.set_blocking(fd, False)
            os.set_inheritable(fd, False)

    def beat(self, state: str, reason: str, daemon: str | None = None) -> None:
        """It gets on; never blocks."""
        now = time.monotonic()
        reached = None if daemon is None else redact(daemon)[:REASON_CHARACTERS_MAX]
        said = Said(state, redact(reason)[:REASON_CHARACTERS_MAX], reached)
        if now < self._next and said == self._said:
            return
        first, self._said, self._next = not self._said.state, said, now + systemd.feed_seconds()
        if self._fd is None:
            text = systemd.status(f"{said.state}: {said.reason}" if said.reason else said.state)
            systemd.notify("WATCHDOG=1", text, *(["READY=1"] if first else []))
            return
        try:
            os.write(self._fd, msgspec.json.encode(said) + b"\n")
        except BlockingIOError:  # the process above does not read; it will
            pass
        except BrokenPipeError:  # it has gone, which somebody else looks after
            self._fd = None


class Ear:
    """In the process above: the other end of the pipe."""

    def __init__(self) -> None:
        self._fd, self.child_fd = os.pipe()
        """``child_fd`` is for the child, to be closed here when the child has it."""
        os.set_blocking(self._fd, False)
        self._rest = b""

    def listen(self) -> Said | None:
        """What was said last since the last time; None if nothing was. Never blocks."""
        try:
            heard = os.read(self._fd, _READ_BYTES)
        except BlockingIOError:
            return None
        *lines, self._rest = (self._rest + heard).split(b"\n")
        if len(self._rest) > _READ_BYTES:
            self._rest = b""
        for line in reversed(lines):
            try:
                return msgspec.json.decode(line, type=Said)
            except (msgspec.MsgspecError, UnicodeDecodeError):
                continue
        return None

    def close(self) -> None:
        """The child has ended."""
        os.close(self._fd)
