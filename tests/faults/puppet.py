"""A process on the bus that is controlled by a test: the intruder, and the control that sees all.

Commands are JSON lines on standard input, answers are JSON lines on standard output. The first line
is zenoh's settings.
"""

from __future__ import annotations

import json
import sys
import threading
from typing import Any

import zenoh


def settings(values: dict[str, Any]) -> zenoh.Config:
    """Return zenoh's configuration with these values."""
    config = zenoh.Config()
    for key, value in values.items():
        config.insert_json5(key, json.dumps(value))
    return config


class Puppet:
    """The commands."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._heard: list[str] = []
        self._mutex = threading.Lock()
        self._kept: list[Any] = []

    def hear(self, sample: zenoh.Sample) -> None:
        with self._mutex:
            self._heard.append(f"{str(sample.kind).rpartition('.')[2].lower()} {sample.key_expr}")

    def put(self, key: str, payload: str = "x", count: int = 1, repeat: int = 1) -> None:
        content = payload.encode() * repeat
        for _ in range(count):
            self._session.put(key, content, congestion_control=zenoh.CongestionControl.BLOCK)

    def delete(self, key: str) -> None:
        self._session.delete(key)

    def subscribe(self, key: str) -> None:
        self._kept.append(
            self._session.declare_subscriber(key, self.hear, allowed_origin=zenoh.Locality.REMOTE)
        )

    def watch(self, key: str) -> None:
        """Subscribe to liveliness tokens."""
        liveliness = self._session.liveliness()
        self._kept.append(liveliness.declare_subscriber(key, self.hear, history=True))

    def appear(self, key: str) -> None:
        self._kept.append(self._session.liveliness().declare_token(key))

    def answer(self, key: str, payload: str) -> None:
        def reply(query: zenoh.Query) -> None:
            with query:
                query.reply(query.key_expr, payload)

        self._kept.append(self._session.declare_queryable(key, reply))

    def ask(self, key: str, seconds: float = 0.5) -> list[str]:
        channel = zenoh.handlers.FifoChannel(100)
        replies = self._session.get(
            key,
            channel,
            timeout=seconds,
            consolidation=zenoh.ConsolidationMode.NONE,
            allowed_destination=zenoh.Locality.REMOTE,
        )
        return [(r.ok or r.err).payload.to_bytes().decode("utf-8", "replace") for r in replies]

    def reset(self) -> None:
        """Undeclare everything, and forget what was heard."""
        for declared in self._kept:
            declared.undeclare()
        self._kept.clear()
        with self._mutex:
            self._heard.clear()

    def ask_many(self, key: str, times: int) -> None:
        """Send queries with the priority of predictions, without waiting for answers."""
        for _ in range(times):
            self._session.get(
                key, lambda reply: None, timeout=60.0, priority=zenoh.Priority.INTERACTIVE_HIGH
            )

    def heard(self) -> list[str]:
        with self._mutex:
            return list(self._heard)


def main() -> None:
    for line in sys.stdin:  # until one is accepted: `open` may be tried several times
        try:
            session = zenoh.open(settings(json.loads(line)))
        except zenoh.ZError as error:
            print(json.dumps({"refused": str(error)}), flush=True)
        else:
            break
    else:
        return
    print(json.dumps({"open": True}), flush=True)
    puppet = Puppet(session)
    for line in sys.stdin:
        name, arguments = json.loads(line)
        try:
            result = getattr(puppet, name)(**arguments)
        except zenoh.ZError as error:
            result = f"error: {error}"
        print(json.dumps({"done": result}), flush=True)
    session.close()


if __name__ == "__main__":
    main()
