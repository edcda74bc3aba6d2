"""Heartbeats of a camera's process to its supervisor, or to systemd.

They show that its work is making progress; they are lines of JSON through a pipe.
"""

from __future__ import annotations

import os
import time

import msgspec
from msgspec import Struct

from camtopod.redact import redact
from camtopod.serve.runtime import systemd

REASON_CHARACTERS_MAX = 300
"""Longest reason in a heartbeat."""
_READ_BYTES = 65536
"""Most bytes read at a time, and most of an unfinished line."""


class Heartbeat(Struct, frozen=True):
    """Content of a heartbeat: the state of the camera's process."""

    state: str
    reason: str
    daemon: str | None = None
    """Reason why the daemon is not reached; "" if it is reached, None while that is not known."""


class HeartbeatSender:
    """Sender, in the camera's process: `beat` in every turn of the loop that reads frames."""

    def __init__(self, fd: int | None) -> None:
        """fd: write end of the supervisor's pipe; None if there is only systemd."""
        self._fd = fd
        self._said = Heartbeat("", "")
        self._next = 0.0
        if fd is not None:
            os.set_blocking(fd, False)
            os.set_inheritable(fd, False)

    def beat(self, state: str, reason: str, daemon: str | None = None) -> None:
        """Send a heartbeat unless nothing changed and the last one is recent; never blocks."""
        now = time.monotonic()
        reached = None if daemon is None else redact(daemon)[:REASON_CHARACTERS_MAX]
        said = Heartbeat(state, redact(reason)[:REASON_CHARACTERS_MAX], reached)
        if now < self._next and said == self._said:
            return
        first, self._said, self._next = not self._said.state, said, now + systemd.feed_seconds()
        if self._fd is None:
            text = systemd.status(f"{said.state}: {said.reason}" if said.reason else said.state)
            systemd.notify("WATCHDOG=1", text, *(["READY=1"] if first else []))
            return
        try:
            os.write(self._fd, msgspec.json.encode(said) + b"\n")
        except BlockingIOError:  # the supervisor is not reading at the moment
            pass
        except BrokenPipeError:  # the supervisor has gone; `leaving` ends this process
            self._fd = None


class HeartbeatReceiver:
    """Receiver, in the supervisor: the other end of the pipe."""

    def __init__(self) -> None:
        self._fd, self.child_fd = os.pipe()
        """Descriptor for the child; close it here once the child has it."""
        os.set_blocking(self._fd, False)
        self._rest = b""

    def listen(self) -> Heartbeat | None:
        """Return the newest heartbeat since the last call; None if there was none. Never blocks."""
        try:
            heard = os.read(self._fd, _READ_BYTES)
        except BlockingIOError:
            return None
        *lines, self._rest = (self._rest + heard).split(b"\n")
        if len(self._rest) > _READ_BYTES:
            self._rest = b""
        for line in reversed(lines):
            try:
                return msgspec.json.decode(line, type=Heartbeat)
            except (msgspec.MsgspecError, UnicodeDecodeError):
                continue
        return None

    def close(self) -> None:
        """Close the pipe once the child has ended."""
        os.close(self._fd)
