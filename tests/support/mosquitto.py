"""A real MQTT broker for tests."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

from serving import wait_for

PROGRAM = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin:/usr/local/sbin")


class Broker:
    """A mosquitto on a port of its own, which it keeps over restarts."""

    def __init__(self, folder: Path, port: int, *options: str) -> None:
        self.port = port
        self._config = folder / "mosquitto.conf"
        open_to_all = (
            [] if any("password_file" in option for option in options) else ["allow_anonymous true"]
        )
        lines = ["user root", f"listener {port} 127.0.0.1", *open_to_all, *options]
        self._config.write_text("\n".join(lines) + "\n")
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> bool:
        """Start the broker; return False if it ends, as its port may have been taken meanwhile."""
        assert PROGRAM is not None
        self._process = process = subprocess.Popen(
            [PROGRAM, "-c", str(self._config)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        wait_for(lambda: process.poll() is not None or self._answers(), "mosquitto")
        return process.poll() is None

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def publish(self, lines: list[bytes], **options: object) -> None:
        """Publish messages as Frigate does."""
        from paho.mqtt import publish

        publish.multiple(
            [("frigate/events", line, 1, False) for line in lines],
            "127.0.0.1",
            self.port,
            **options,
        )

    def _answers(self) -> bool:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
            return True
        return False


@contextlib.contextmanager
def mosquitto(folder: Path, *options: str) -> Iterator[Broker]:
    """Run a broker while the block runs."""
    for _ in range(5):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            broker = Broker(folder, probe.getsockname()[1], *options)
        if broker.start():
            break
        broker.stop()
    try:
        yield broker
    finally:
        broker.stop()
