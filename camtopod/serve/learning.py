"""The learner in a thread of its own, so that a refit holds nothing up; and its replay from the journal."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable
from typing import Protocol

from camtopod import codec
from camtopod.learn.settings import Settings
from camtopod.learn.topology import make_delta
from camtopod.records import Event, Topology
from camtopod.serve.journal import Entry, Journal
from camtopod.serve.progress import Beat, no_beat
from camtopod.serve.receiver import Received, Version, decode

log = logging.getLogger(__name__)

_TICK_SECONDS = 0.2
_PROGRESS_ENTRIES = 200_000


class Learns(Protocol):
    """What the daemon needs of `camtopod.learn.learner.Learner`."""

    @property
    def topology(self) -> Topology | None: ...
    def receive(self, event: Event) -> str: ...
    def advance(self, now: float) -> None: ...
    def updates(self) -> list[Topology]: ...
    def next_deadline(self) -> float | None: ...
    def statistics(self) -> dict[str, int | float]: ...


MakeLearner = Callable[[Settings, str, str], Learns]
"""(settings, site, epoch) -> learner."""


class ReplayMismatch(Exception):
    """The journal did not lead to the versions that were published from it."""


class Learning:
    """Feeds a learner. Its thread gives each version to ``on_version``, the deadline to ``on_deadline``."""

    def __init__(
        self,
        learner: Learns,
        events_max: int,
        on_version: Callable[[Version], None],
        on_deadline: Callable[[float | None], None],
    ) -> None:
        self._learner = learner
        self._events_max = events_max
        self._on_version = on_version
        self._on_deadline = on_deadline
        self._queue: queue.SimpleQueue[list[Received]] = queue.SimpleQueue()
        self._waiting = 0
        self._mutex = threading.Lock()
        self._topology = learner.topology
        self.statistics = learner.statistics()
        """The learner's, as of its last step."""
        on_deadline(learner.next_deadline())

    def feed(self, batch: list[Received]) -> None:
        """Learn these, in this order, soon. Any thread."""
        with self._mutex:
            self._waiting += len(batch)
        self._queue.put(batch)

    def room(self) -> int:
        """How many events may be fed at the moment."""
        return self._events_max - self._waiting

    @property
    def waiting(self) -> int:
        """Events fed and not learned yet."""
        return self._waiting

    def work(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Learn until ``stopping``; what is not learned by then is in the journal."""
        while not stopping.is_set():
            try:
                batch = self._queue.get(timeout=_TICK_SECONDS)
            except queue.Empty:
                beat()
                continue
            for received in batch:
                feed_one(self._learner, received)
                self._hand_out()
                beat()
                if stopping.is_set():
                    return
            with self._mutex:
                self._waiting -= len(batch)
            self.statistics = self._learner.statistics()
            self._on_deadline(self._learner.next_deadline())

    def _hand_out(self) -> None:
        for topology in self._learner.updates():
            delta = None if self._topology is None else make_delta(self._topology, topology)
            self._topology = topology
            self._on_version(Version(topology, delta))


def feed_one(learner: Learns, received: Received) -> None:
    """One committed entry into the learner."""
    if received.event is not None:
        learner.receive(received.event)
    elif received.advance is not None:
        learner.advance(received.advance)


def replay(
    journal: Journal, learner: Learns, on_event: Callable[[Event], None], cancelled: threading.Event
) -> list[Topology]:
    """Feed a fresh learner all of the journal; returns the versions that had not been stored yet.

    Raises `ReplayMismatch` when the versions that were stored do not come out again. ``on_event`` sees the
    events too. Ends early once ``cancelled`` is set.
    """
    published = journal.versions()
    last = max(published, default=0)
    new: list[Topology] = []
    damaged = 0
    for number, (_, entry) in enumerate(journal.entries(), start=1):
        if cancelled.is_set():
            return []
        if entry is None:
            damaged += 1
            continue
        received = _received(entry.kind, entry.raw)
        feed_one(learner, received)
        if received.event is not None:
            on_event(received.event)
        for topology in learner.updates():
            stored = published.pop(topology.version, None)
            if topology.version > last:
                new.append(topology)
            elif stored is not None and stored != topology.digest:
                raise ReplayMismatch(f"version {topology.version} has another digest than it had")
        if number % _PROGRESS_ENTRIES == 0:
            log.info("replayed %d of %d journal entries", number, len(journal))
    if damaged:
        log.error("%d damaged entries of the journal are left out; they are still in the file", damaged)
    if published:
        raise ReplayMismatch(f"version {max(published)} does not come out any more")
    return new


def _received(kind: str, raw: bytes) -> Received:
    entry = Entry("event", "", None, None, raw)
    if kind == "event":
        try:
            return Received(entry, decode(raw))
        except codec.Rejected as error:  # a newer program accepted it
            log.error("an entry of the journal cannot be read any more: %s", error)
    elif kind == "advance":
        return Received(entry, advance=float(raw))
    return Received(entry)
