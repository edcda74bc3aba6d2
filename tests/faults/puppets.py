"""Processes on the bus that a test controls; see puppet.py."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from serving import WAIT_SECONDS, wait_for

from camtopod.keys import rules

HQ = "camtopo/hq"


class Puppet:
    """A process with a session on the bus."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("puppet.py"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )

    @property
    def pid(self) -> int:
        return self._process.pid

    def open(self, **settings: Any) -> bool:
        """Return True if the session is accepted."""
        return "open" in self._say(settings)

    def do(self, name: str, **arguments: Any) -> Any:
        return self._say([name, arguments])["done"]

    def hears(self, *expected: str) -> None:
        wait_for(
            lambda: set(expected) <= set(self.do("heard")),
            f"{expected}, not only {set(self.do('heard'))}",
        )

    def close(self) -> None:
        self._process.communicate(timeout=WAIT_SECONDS)

    def _say(self, what: Any) -> dict[str, Any]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(what).encode() + b"\n")
        self._process.stdin.flush()
        answer: dict[str, Any] = json.loads(self._process.stdout.readline())
        return answer


def client(endpoint: str, mode: str = "client") -> dict[str, Any]:
    """Return zenoh's settings for a session that dials ``endpoint``."""
    return rules.session_settings(mode) | {
        "connect/endpoints": [endpoint],
        "listen/endpoints": [],
        "connect/timeout_ms": 500,
        "connect/exit_on_failure": True,
    }
