"""Processes on the bus that a test controls: intruders, and the control that sees all."""

from __future__ import annotations

import itertools
import json
import multiprocessing
import os
import threading
import time
from multiprocessing.managers import BaseManager
from typing import Any

import zenoh

from camtopod.keys import rules

HQ = "camtopo/hq"
WAIT_SECONDS = 60.0
_SPAWN = multiprocessing.get_context("spawn")


class _Session:
    """A session on the bus; it lives in the puppet's process."""

    def __init__(self) -> None:
        self._heard: list[str] = []
        self._mutex = threading.Lock()
        self._kept: list[Any] = []

    def open(self, settings: dict[str, Any]) -> bool:
        """Return True if the session is accepted; else it may be tried again."""
        config = zenoh.Config()
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError:
            return False
        return True

    def pid(self) -> int:
        return os.getpid()

    def put(self, key: str, payload: str = "x", count: int = 1, repeat: int = 1) -> None:
        for _ in range(count):
            blocks = zenoh.CongestionControl.BLOCK
            self._session.put(key, payload.encode() * repeat, congestion_control=blocks)

    def delete(self, key: str) -> None:
        self._session.delete(key)

    def subscribe(self, key: str) -> None:
        origin = zenoh.Locality.REMOTE
        self._kept.append(self._session.declare_subscriber(key, self._hear, allowed_origin=origin))

    def watch(self, key: str) -> None:
        """Subscribe to liveliness tokens."""
        liveliness = self._session.liveliness()
        self._kept.append(liveliness.declare_subscriber(key, self._hear, history=True))

    def appear(self, key: str) -> None:
        self._kept.append(self._session.liveliness().declare_token(key))

    def answer(self, key: str, payload: str) -> None:
        def reply(query: zenoh.Query) -> None:
            with query:
                query.reply(query.key_expr, payload)

        self._kept.append(self._session.declare_queryable(key, reply))

    def ask(self, key: str, seconds: float | None = None) -> list[str]:
        """Return the answers of half a second, or the first one within ``seconds``.

        On a busy machine zenoh sometimes loses the message that ends a query.
        """
        replies = self._session.get(
            key,
            zenoh.handlers.FifoChannel(100),
            timeout=seconds or 0.5,
            consolidation=zenoh.ConsolidationMode.NONE,
            allowed_destination=zenoh.Locality.REMOTE,
        )
        some = itertools.islice(replies, None if seconds is None else 1)
        return [(r.ok or r.err).payload.to_bytes().decode("utf-8", "replace") for r in some]

    def ask_many(self, key: str, times: int) -> None:
        """Send queries with the priority of predictions, without waiting for answers."""
        urgent = zenoh.Priority.INTERACTIVE_HIGH
        for _ in range(times):
            self._session.get(key, lambda reply: None, timeout=60.0, priority=urgent)

    def heard(self) -> list[str]:
        with self._mutex:
            return list(self._heard)

    def reset(self) -> None:
        """Undeclare everything, and forget what was heard."""
        for declared in self._kept:
            declared.undeclare()
        self._kept.clear()
        with self._mutex:
            self._heard.clear()

    def _hear(self, sample: zenoh.Sample) -> None:
        with self._mutex:
            self._heard.append(f"{str(sample.kind).rpartition('.')[2].lower()} {sample.key_expr}")


class _Manager(BaseManager):
    """Runs the process."""


_Manager.register("Session", _Session)


class Puppet:
    """A process with a session on the bus, which is not open yet."""

    def __init__(self) -> None:
        self._manager = _Manager(ctx=_SPAWN)
        self._manager.start()
        self._session: Any = self._manager.Session()  # type: ignore[attr-defined]
        self.pid: int = self._session.pid()

    def open(self, **settings: Any) -> bool:
        """Return True if the session is accepted."""
        return bool(self._session.open(settings))

    def do(self, name: str, **arguments: Any) -> Any:
        """Let it do something; see `_Session`."""
        return getattr(self._session, name)(**arguments)

    def hears(self, *expected: str) -> None:
        """Wait until it has heard all of these."""
        heard: set[str] = set()
        deadline = time.monotonic() + WAIT_SECONDS
        while not heard.issuperset(expected):
            assert time.monotonic() < deadline, f"{expected}, not only {heard}"
            heard = set(self.do("heard"))

    def close(self) -> None:
        self._manager.shutdown()


def client(endpoint: str, mode: str = "client") -> dict[str, Any]:
    """Return zenoh's settings for a session that dials ``endpoint``."""
    return rules.session_settings(mode) | {
        "connect/endpoints": [endpoint],
        "listen/endpoints": [],
        "connect/timeout_ms": 500,
        "connect/exit_on_failure": True,
    }
