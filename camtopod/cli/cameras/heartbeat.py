"""Heartbeats of a camera's process, which show that its work is making progress.

They are notifications as systemd takes them (sd_notify): to the supervisor, or to systemd itself.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Sequence

from camtopod.redact import redact
from camtopod.serve.runtime import systemd

_WAITING_MAX = 16
"""Most notifications read at a time; the kernel keeps ten."""


class HeartbeatSender:
    """Sends heartbeats; call `beat` in every turn of the loop that reads frames."""

    def __init__(self) -> None:
        self._last = ""
        self._next_at = 0.0

    def beat(self, state: str, reason: str) -> None:
        """Send a heartbeat unless nothing changed and the last one is recent."""
        text = redact(f"{state}: {reason}")[:300]
        now = time.monotonic()
        if now < self._next_at and text == self._last:
            return
        self._last = text
        self._next_at = now + systemd.feed_seconds()
        systemd.notify("READY=1", "WATCHDOG=1", systemd.status(text.removesuffix(": ")))


class HeartbeatReceiver:
    """Receives the heartbeats of one process."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.bind("")  # to an abstract address that the kernel chooses
        self._socket.setblocking(False)
        self.address = f"@{self._socket.getsockname()[1:].decode()}"
        """Value of the process's `NOTIFY_SOCKET`."""

    def lines(self) -> list[str]:
        """Return the lines of all notifications since the last call. Never blocks."""
        lines: list[str] = []
        with contextlib.suppress(BlockingIOError):
            for _ in range(_WAITING_MAX):
                lines += self._socket.recv(4096).decode("utf-8", "replace").splitlines()
        return lines

    def close(self) -> None:
        """Close the socket once the process has ended."""
        self._socket.close()


def state_of(lines: Sequence[str]) -> tuple[str, str] | None:
    """Return state and reason of the newest heartbeat in notifications; None without one."""
    statuses = [line.removeprefix("STATUS=") for line in lines if line.startswith("STATUS=")]
    if not statuses:
        return None
    state, _, reason = statuses[-1].partition(": ")
    return state, reason
