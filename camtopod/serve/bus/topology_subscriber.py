"""Follow the topology of a site's daemon: subscribe to deltas, query the whole, apply deltas to it.

The whole topology is queried again when a delta is missing.
"""

from __future__ import annotations

import logging
import time
from collections import deque

from camtopod import codec
from camtopod.keys.rules import STATUS
from camtopod.records import DaemonStatus, Delta, Topology
from camtopod.serve.bus.session import Bus, QueryError
from camtopod.topology import apply_delta

log = logging.getLogger(__name__)

WAITING_MAX = 1000
"""Most deltas that wait for `TopologySubscriber.update`; beyond it the oldest are dropped."""


class TopologySubscriber:
    """The newest topology of one site's daemon. Call `update` from one thread, as often as needed.

    A late start, a missed delta, a restarted daemon and a new epoch are all handled the same way:
    the whole topology is queried. A missing delta is noticed with the next one, or from the
    daemon's status.
    """

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._deltas: deque[bytes] = deque(maxlen=WAITING_MAX)
        self._stale = True
        self._ask_after = 0.0
        self.topology: Topology | None = None
        """The newest version received; None before the first."""
        self.fetched = 0
        """Number of times the whole topology was queried and received."""
        bus.subscribe("topology/delta", self._on_delta)
        bus.subscribe(STATUS, self._on_status)
        bus.watch_alive("daemon", self._on_daemon)

    def update(self) -> Topology | None:
        """Process what has been received; return the newest version, or None if it is not new."""
        before = self.topology
        while self._deltas:
            self._apply(self._deltas.popleft())
        if self._stale and time.monotonic() >= self._ask_after:
            self._fetch()
        return self.topology if self.topology is not before else None

    def _on_delta(self, key: str, payload: bytes) -> None:
        self._deltas.append(payload)

    def _on_daemon(self, name: str, alive: bool) -> None:
        if alive:
            self._stale = True
            self._ask_after = 0.0

    def _on_status(self, key: str, payload: bytes) -> None:
        """Query the whole topology if the daemon has had a newer version since its last status."""
        try:
            newest = codec.read(DaemonStatus, payload, pack=True)
        except codec.Rejected as error:
            log.debug("ignoring a malformed status of the daemon: %s", error)
            return
        held = self.topology
        told = (newest.epoch, newest.version)
        if newest.version > 0 and (held is None or told > (held.epoch, held.version)):
            self._stale = True

    def _apply(self, payload: bytes) -> None:
        """Apply a delta; if that is impossible, have the whole topology queried."""
        try:
            delta = codec.read(Delta, payload, pack=True)
        except codec.Rejected as error:
            log.warning("malformed delta, querying the whole topology: %s", error)
            self._stale = True
            return
        held = self.topology
        if held is not None and (delta.epoch, delta.version) <= (held.epoch, held.version):
            return  # the whole topology had it already; epochs sort by time
        try:
            if held is None:
                raise ValueError("there is no topology yet to apply the delta to")
            self.topology = apply_delta(held, delta)
        except ValueError as error:
            log.info("querying the whole topology: %s", error)
            self._stale = True
            self._ask_after = 0.0

    def _fetch(self) -> None:
        """Query the whole topology."""
        self._ask_after = time.monotonic() + 0.5  # not more often than that
        self._stale = False  # before the query: a daemon may restart meanwhile

        # Query and decode.
        try:
            answers = self._bus.query("topology", one=True)
        except QueryError:  # nothing learned yet
            answers = []
        try:
            newest = codec.decode_topology(answers[0][1], pack=True) if answers else None
        except codec.Rejected as error:
            log.warning("malformed topology, querying it again: %s", error)
            newest = None
        if newest is None:
            self._stale = True
            return

        # Keep it if it is newer.
        self.fetched += 1
        held = self.topology
        # Another epoch is taken even if it is older: then a daemon has lost its state and its
        # clock is behind. An older version of the same epoch is not: the delta was faster.
        if held is None or newest.epoch != held.epoch or newest.version > held.version:
            self.topology = newest
