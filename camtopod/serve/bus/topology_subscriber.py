"""The topology as a subscriber sees it: subscribe, then get, then apply by version, get again on a
gap.
"""

from __future__ import annotations

import logging
import queue
import time

from msgspec import Struct

from camtopod import codec
from camtopod.keys import STATUS
from camtopod.records import Delta, Topology
from camtopod.serve.bus.session import Bus, QueryError
from camtopod.topology import apply_delta

log = logging.getLogger(__name__)

WAITING_MAX = 1000
"""Deltas that wait for `TopologyView.update`; beyond it they are dropped and the whole is
fetched.
"""
BEHIND_SECONDS = 1.0
"""A delta is taken for lost when the daemon has had a newer version for this long."""
_ASK_AGAIN_SECONDS = 0.5
_TICK_SECONDS = 0.1


class _Status(Struct):
    """What of ``status/daemon`` says which version is the newest."""

    epoch: str
    version: int


class TopologyView:
    """Follows the versions of one site's daemon. `update` from one thread, as often as one likes.

    Late joiners, missed deltas, a daemon that restarts and one that begins a new epoch all end the
    same way: the whole topology is fetched. That a delta is missing shows with the next, or in the
    daemon's status.
    """

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._deltas: queue.Queue[bytes] = queue.Queue(WAITING_MAX)
        self._stale = True
        self._ask_after = 0.0
        self._behind_since: float | None = None
        self.topology: Topology | None = None
        """The newest version seen, None before the first."""
        self.fetched = 0
        """How often the whole topology was fetched."""
        bus.subscribe("topology/delta", self._on_delta)
        bus.subscribe(STATUS, self._on_status)
        bus.watch_alive("daemon", self._on_daemon)

    def update(self) -> Topology | None:
        """Work off what has arrived; returns the newest version if it is newer than before, else
        None.
        """
        before = self.topology
        while True:
            try:
                self._apply(self._deltas.get_nowait())
            except queue.Empty:
                break
        if self._stale and time.monotonic() >= self._ask_after:
            self._fetch()
        return self.topology if self.topology is not before else None

    def wait_for(self, version: int, seconds: float) -> Topology | None:
        """`update` until at least ``version`` is there; returns the newest, or None when the time
        is over.
        """
        deadline = time.monotonic() + seconds
        while True:
            self.update()
            if self.topology is not None and self.topology.version >= version:
                return self.topology
            if time.monotonic() >= deadline:
                return None
            time.sleep(_TICK_SECONDS)

    def _on_delta(self, key: str, payload: bytes) -> None:
        try:
            self._deltas.put_nowait(payload)
        except queue.Full:
            self._stale = True

    def _on_daemon(self, name: str, alive: bool) -> None:
        if alive:
            self._stale = True
            self._ask_after = 0.0

    def _on_status(self, key: str, payload: bytes) -> None:
        try:
            newest = codec.read(_Status, payload, pack=True)
        except codec.Rejected as error:
            log.debug("a status that cannot be read: %s", error)
            return
        held, now = self.topology, time.monotonic()
        if newest.version == 0 or (
            held is not None and (newest.epoch, newest.version) <= (held.epoch, held.version)
        ):
            self._behind_since = None
        elif self._behind_since is None:
            self._behind_since = now
        elif now - self._behind_since >= BEHIND_SECONDS:
            self._behind_since, self._stale = now, True

    def _apply(self, payload: bytes) -> None:
        try:
            delta = codec.read(Delta, payload, pack=True)
        except codec.Rejected as error:
            log.warning("a delta that cannot be read: %s", error)
            self._stale = True
            return
        held = self.topology
        if held is not None and (delta.epoch, delta.version) <= (held.epoch, held.version):
            return  # it came with the whole already; epochs sort by time
        try:
            if held is None:
                raise ValueError("there is nothing yet to apply it to")
            self.topology = apply_delta(held, delta)
        except ValueError as error:
            log.info("fetching the whole topology: %s", error)
            self._stale = True
            self._ask_after = 0.0

    def _fetch(self) -> None:
        self._ask_after = time.monotonic() + _ASK_AGAIN_SECONDS
        self._stale = False  # before asking: a daemon may come back meanwhile
        try:
            answers = self._bus.ask("topology", one=True)
        except QueryError:  # nothing learned yet
            answers = []
        try:
            newest = codec.read_topology(answers[0][1], pack=True) if answers else None
        except codec.Rejected as error:
            log.warning("a topology that cannot be read: %s", error)
            newest = None
        if newest is None:
            self._stale = True
            return
        self.fetched += 1
        held = self.topology
        # An epoch before the one held: a daemon has lost its state while its clock was behind. A
        # version before the one held, in the same epoch: the delta was faster than the answer.
        if held is None or newest.epoch != held.epoch or newest.version > held.version:
            self.topology = newest
