"""Processes of their own: `camtopod run`, and scripts of this folder."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import re
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import msgspec
from serving import WAIT_SECONDS, camtopod, wait_for

from camtopod.config.settings import BusSettings, Config
from camtopod.serve.bus import Bus, dial

READY_SECONDS = 60.0
"""Longest wait for a process to start or answer, seconds."""
OPEN = '[bus]\nlisten = ["tcp/127.0.0.1:0"]\n'
"""Configuration of a bus for programs of this machine."""


def script(name: str, *arguments: object, **popen: Any) -> subprocess.Popen[bytes]:
    """Start a script of this folder; what it prints is in its ``stdout``."""
    return subprocess.Popen(
        [sys.executable, str(Path(__file__).with_name(name)), *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
        **popen,
    )


class RealDaemon:
    """A daemon with the state in ``folder``; its output is in ``said``. ``popen`` is passed on.

    seconds: longest wait until it is ready.
    """

    def __init__(
        self, folder: Path, toml: str, seconds: float = READY_SECONDS, **popen: Any
    ) -> None:
        folder.mkdir(exist_ok=True)
        config = folder / "camtopod.toml"
        config.write_text(f'{toml}[state]\ndirectory = "{folder}/state"\n')
        config.chmod(0o600)
        self.process = camtopod("--config", str(config), "run", stderr=subprocess.PIPE, **popen)
        self.said: list[str] = []
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()
        wait_for(lambda: self._ready() is not None, "the daemon to be ready", seconds)
        self.endpoint = str(self._ready())

    def dial(self) -> Bus:
        return dial(Config(bus=BusSettings(connect=(self.endpoint,), connect_seconds=30.0)))

    def stop(self) -> None:
        self.process.terminate()
        self.close()

    def close(self) -> None:
        """Release what belongs to a process that ends."""
        self.process.wait(WAIT_SECONDS)
        self._thread.join()
        assert self.process.stderr is not None
        self.process.stderr.close()

    def _listen(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.said.append(line.decode())

    def _ready(self) -> str | None:
        found = re.search(r"ready at (\S+)", "".join(self.said))
        return found and found.group(1)


def readiness(address: str) -> tuple[int, list[str]]:
    """Return status and reasons of ``/readyz`` of the daemon whose health is at HOST:PORT."""
    host, _, port = address.rpartition(":")
    connection = http.client.HTTPConnection(host, int(port), timeout=READY_SECONDS)
    with contextlib.closing(connection):
        connection.request("GET", "/readyz")
        answer = connection.getresponse()
        return answer.status, json.loads(answer.read())["reasons"]


def status_over(bus: Bus) -> dict[str, Any]:
    """Return the daemon's status, asking again if a busy machine delays the answer."""
    answers: list[tuple[str, bytes]] = []

    def answered() -> bool:
        answers[:] = bus.query("status/daemon", seconds=2.0, one=True)
        return bool(answers)

    wait_for(answered, "the daemon to answer", READY_SECONDS)
    status: dict[str, Any] = msgspec.msgpack.decode(answers[0][1])
    return status
