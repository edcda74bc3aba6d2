"""A fake systemd that records the notifications of services."""

from __future__ import annotations

import socket
import time

from serving import wait_for


class Systemd:
    """The notification socket, and the lines it has received."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind("\0" + address[1:] if address.startswith("@") else address)
        self._socket.settimeout(0.05)
        self.told: list[str] = []

    def hear(self, seconds: float = 0.0) -> list[str]:
        """Return the lines that arrive within ``seconds`` or have arrived already."""
        new: list[str] = []
        deadline = time.monotonic() + seconds
        while True:
            try:
                new += self._socket.recv(65536).decode().split("\n")
            except TimeoutError:
                if time.monotonic() >= deadline:
                    break
        self.told += new
        return new

    def wait_for(self, line: str) -> None:
        """Wait until ``line`` has been received, now or before."""
        wait_for(
            lambda: self.hear() is not None and line in self.told,
            f"{line} (told: {self.told[-20:]})",
        )

    def close(self) -> None:
        self._socket.close()
