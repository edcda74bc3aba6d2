"""Follow the topology of a site's daemon: take each version it publishes, query what was missed."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from msgspec.structs import replace

from camtopod import codec
from camtopod.keys.rules import STATUS
from camtopod.records import DaemonStatus, Topology, VersionModel
from camtopod.serve.bus.session import Bus, QueryError

log = logging.getLogger(__name__)

PARTS: dict[str, type] = {"topology/model": VersionModel, "topology": Topology}
"""Types of the two parts of a version, by key."""
QUERY_INTERVAL_SECONDS = 0.5
"""Shortest time between two queries for the topology."""


class TopologySubscriber:
    """The newest topology of one site's daemon. Call `update` from one thread, as often as needed.

    A version is new when its map and its model are there, in whichever order they come. A late
    start, a missed version and a restarted daemon are all handled the same way: the topology is
    queried. A missed version is noticed from the daemon's status.

    on_news: called by other threads when a version is published, and when a daemon comes or goes.
    """

    def __init__(self, bus: Bus, on_news: Callable[[], None] = lambda: None) -> None:
        self._bus = bus
        self._on_news = on_news
        self._queue: deque[tuple[str, bytes]] = deque(maxlen=2)
        """The newest map and model that `update` has not seen; another thread appends them."""
        self._parts: dict[str, Any] = dict.fromkeys(PARTS)
        """The newest map and model, by key."""
        self._stale = True
        self._ask_after = 0.0
        self._is_answered = False
        """True once a daemon has told its version, or that it has none."""
        self.topology: Topology | None = None
        """The newest version received; None before the first."""
        self.fetch_count = 0
        """Number of times the topology was queried and received."""
        self.daemons: set[str] = set()
        """Names of the daemons that are there; another thread changes it."""
        for key in PARTS:
            bus.subscribe(key, self._on_part)
        bus.subscribe(STATUS, self._on_status)
        bus.watch_alive("daemon", self._on_daemon)

    def update(self) -> Topology | None:
        """Process what has been received; return the newest version, or None if it is not new."""
        before = self.topology
        while self._queue:
            self._take(*self._queue.popleft())
        if self._stale and time.monotonic() >= self._ask_after:
            self._fetch()
        return self.topology if self.topology is not before else None

    def first(self, seconds: float) -> Topology | None:
        """Return the version of a daemon that is there; None if it has none.

        A program that has just joined may ask before the bus knows who answers, and asks again.

        seconds: longest wait for an answer.
        """
        deadline = time.monotonic() + seconds
        while (version := self.update()) is None and not self._is_answered:
            if not self.daemons or time.monotonic() >= deadline:
                break
            time.sleep(max(self._ask_after - time.monotonic(), 0.0))
        return version

    def _on_part(self, key: str, payload: bytes) -> None:
        self._queue.append((key, payload))
        self._on_news()

    def _on_daemon(self, name: str, alive: bool) -> None:
        self.daemons.discard(name)
        if alive:
            self.daemons.add(name)
            self._stale = True
            self._ask_after = 0.0
        self._on_news()

    def _on_status(self, key: str, payload: bytes) -> None:
        """Query the whole topology if the daemon has had a newer version since its last status."""
        try:
            newest = codec.read(DaemonStatus, payload, pack=True)
        except codec.Rejected as error:
            log.debug("ignoring a malformed status of the daemon: %s", error)
            return
        topology = self.topology
        version = (newest.epoch, newest.version)
        if newest.version > 0 and (
            topology is None or version > (topology.epoch, topology.version)
        ):
            self._stale = True

    def _fetch(self) -> None:
        """Query the topology."""
        self._ask_after = time.monotonic() + QUERY_INTERVAL_SECONDS
        self._stale = False  # before the query: a daemon may restart meanwhile
        version: dict[str, object] = {}  # of the model: the next one may come meanwhile
        try:
            for key in PARTS:
                for part in self._bus.query(key, version, one=True):
                    self._take(*part)
                    if (model := self._parts["topology/model"]) is not None:
                        version = {"epoch": model.epoch, "version": model.version}
        except QueryError:  # nothing learned yet, or that version is gone
            self._is_answered = not version
        if not version:
            self._stale = True
            return
        self.fetch_count += 1
        self._is_answered = self._both() is not None
        self._stale = self._stale or not self._is_answered

    def _take(self, key: str, payload: bytes) -> None:
        """Keep a map or a model, and the version if both are there and it is newer.

        One of another epoch is kept even if that is older: then a daemon has lost its state and its
        clock is behind.
        """
        try:
            self._parts[key] = codec.read(PARTS[key], payload, pack=True)
            topology, newest = self.topology, self._both()
            if newest is not None and (
                topology is None
                or newest.epoch != topology.epoch
                or newest.version > topology.version
            ):
                codec.require_sound(newest)
                self.topology = newest
        except codec.Rejected as error:
            log.warning("malformed topology, querying it again: %s", error)
            self._stale = True

    def _both(self) -> Topology | None:
        """Return the version of the newest map and model; None if they are not of one version."""
        map_: Topology | None = self._parts["topology"]
        model: VersionModel | None = self._parts["topology/model"]
        if map_ is None or map_.model is not None:  # a whole version
            return map_
        if model is None or (model.epoch, model.version) != (map_.epoch, map_.version):
            return None
        return replace(map_, model=model.model)
