"""A bus with a single client; the test plays the rest of the site."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from msgspec.structs import replace

from camtopod import codec
from camtopod.records import EventHours, Model, Recent, SeenEvent, Topology
from camtopod.serve.bus import QueryError
from camtopod.topology import map_of, version_model


class OneBus:
    """The methods of a bus that a feed uses; the test plays all other clients."""

    def __init__(self) -> None:
        self.connected = True
        self.site = "site"
        self.endpoint = "tcp/127.0.0.1:1"
        self.subscribed: dict[str, list[Callable[[str, bytes], None]]] = {}
        self.kept: dict[int, Topology] = {}
        self.asked: list[tuple[str, Any]] = []
        self.seen: list[SeenEvent] = []
        """Events that have not been told to who asks once a second."""
        self.told: list[SeenEvent] = []
        self.hours = EventHours(0.0, 0.0, {})

    def subscribe(self, key: str, on_message: Callable[[str, bytes], None]) -> Callable[[], None]:
        self.subscribed.setdefault(key, []).append(on_message)
        return lambda: self.subscribed[key].remove(on_message)

    def watch_alive(self, role: str, on_change: Callable[[str, bool], None]) -> None:
        on_change("daemon", True)

    def query(
        self, key: str, parameters: dict[str, Any] | None = None, one: bool = False
    ) -> list[tuple[str, bytes]]:
        self.asked.append((key, parameters))
        if key == "recent":
            return [(key, self._recent(parameters or {}))]
        if key not in ("topology", "topology/model"):
            return []
        wanted = (parameters or {}).get("version", max(self.kept, default=0))
        if wanted not in self.kept:
            raise QueryError("not kept")
        return [(key, codec.to_msgpack(parts(self.kept[wanted])[key]))]

    def _recent(self, given: dict[str, Any]) -> bytes:
        if "format" in given or "since" not in given:
            hours = self.hours if "hours" in given else None
            recent = Recent(time.time(), [*self.told, *self.seen], hours)
            return codec.to_json(recent) if "format" in given else codec.to_msgpack(recent)
        news, self.seen = self.seen, []
        self.told += news
        return codec.to_msgpack(Recent(time.time(), news))

    def publish(self, key: str, noun: object) -> None:
        pattern = key.split("/")[0] + "/*"
        for part, message in (parts(noun) if isinstance(noun, Topology) else {key: noun}).items():
            for receive in [*self.subscribed.get(part, []), *self.subscribed.get(pattern, [])]:
                receive(part, codec.to_msgpack(message))


NO_MODEL = Model(1.0, 0.1, -1.0, 1.0, b"")


def parts(topology: Topology) -> dict[str, object]:
    """Return the messages of a version by key, as a daemon publishes them."""
    whole = replace(topology, model=topology.model or NO_MODEL)
    return {"topology/model": version_model(whole), "topology": map_of(whole)}
