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


class Heartbeat(Struct, frozen=True):
    """Content of a heartbeat: the state of the camera's process."""

    state: str
    reason: str


class HeartbeatSender:
    """Sender, in the camera's process: `beat` in every turn of the loop that reads frames."""

    def __init__(self, fd: int | None) -> None:
        """fd: write end of the supervisor's pipe; None if there is only systemd."""
        self._fd = fd
        self._last = Heartbeat("", "")
        self._next_at = 0.0
        if fd is not None:
            os.set_blocking(fd, False)
            os.set_inheritable(fd, False)

    def beat(self, state: str, reason: str) -> None:
        """Send a heartbeat unless nothing changed and the last one is recent; never blocks."""
        now = time.monotonic()
        heartbeat = Heartbeat(state, redact(reason)[:300])
        if now < self._next_at and heartbeat == self._last:
            return
        first = not self._last.state
        self._last = heartbeat
        self._next_at = now + systemd.feed_seconds()
        if self._fd is None:
            text = systemd.status(f"{state}: {heartbeat.reason}" if reason else state)
            systemd.notify("WATCHDOG=1", text, *(["READY=1"] if first else []))
            return
        try:
            os.write(self._fd, msgspec.json.encode(heartbeat) + b"\n")
        except BlockingIOError:  # the supervisor is not reading at the moment
            pass
        except BrokenPipeError:  # the supervisor has gone; `ends_within` ends this process
            self._fd = None


class HeartbeatReceiver:
    """Receiver, in the supervisor: the other end of the pipe."""

    def __init__(self) -> None:
        self._fd, self.child_fd = os.pipe()
        """Descriptor for the child; close it here once the child has it."""
        os.set_blocking(self._fd, False)

    def newest(self) -> Heartbeat | None:
        """Return the newest heartbeat since the last call; None if there was none. Never blocks."""
        try:
            lines = os.read(self._fd, 65536).splitlines()
        except BlockingIOError:
            return None
        return msgspec.json.decode(lines[-1], type=Heartbeat) if lines else None

    def close(self) -> None:
        """Close the pipe once the child has ended."""
        os.close(self._fd)
