"""From bytes on the bus to events in the journal, in order, once each; and the acks for them.

One thread owns the journal and the order of the streams. The bus's threads only put bytes into the bounded
inbox. What is committed goes on to the learner and to the live predictions, in the order of the journal.
"""

from __future__ import annotations

import collections
import logging
import queue
import sqlite3
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

from camtopod import codec
from camtopod.config import Limits
from camtopod.records import Ack, Delta, Event, Topology
from camtopod.serve.bus import Bus
from camtopod.serve.clock import Clock
from camtopod.serve.journal import Entry, Journal
from camtopod.serve.progress import Beat, no_beat
from camtopod.serve.rejects import Rejects
from camtopod.serve.spool import SpoolBatch
from camtopod.serve.streams import Streams

log = logging.getLogger(__name__)

_TICK_SECONDS = 0.05
_RETRY_SECONDS = 0.5
_PULLED_MAX = 16
"""Answers of spools that wait in the inbox at a time."""
_JSON_STARTS = b"{ \t\r\n"
"""An event that begins with one of these is JSON: a MessagePack map begins above 0x7f."""


class Received(NamedTuple):
    """On its way into the journal: an event (none if it is not to be learned) or an advance of event time."""

    entry: Entry
    event: Event | None = None
    advance: float | None = None


class Version(NamedTuple):
    """A new version on its way into the journal and then onto the bus."""

    topology: Topology
    delta: Delta | None


class Pulled(NamedTuple):
    """The answer of a spool to a question for ``asked_from`` on."""

    batch: SpoolBatch
    asked_from: int


def decode(raw: bytes) -> Event:
    """An event as MessagePack, or as JSON. Raises `codec.Rejected`."""
    if raw[:1] and raw[0] in _JSON_STARTS:
        return codec.event_from_json(raw)
    return codec.event_from_pack(raw)


class Receiver:
    """Give it bytes with `on_event` and `on_pulled` (any thread), then run `work` in a thread of its own.

    ``learn`` takes what is committed, in journal order, and must not block; ``room()``: how many it takes.
    ``publish``: called with each version after it is stored.
    """

    def __init__(
        self,
        journal: Journal,
        bus: Bus,
        limits: Limits,
        clock: Clock,
        learn: Callable[[list[Received]], None],
        room: Callable[[], int],
        publish: Callable[[Version], None],
    ) -> None:
        self._journal, self._bus, self._limits, self._clock = journal, bus, limits, clock
        self._learn, self._room, self._publish = learn, room, publish
        self._inbox: queue.Queue[tuple[str, bytes] | Pulled] = queue.Queue(limits.inbox_events_max)
        self._pulled_waiting = 0
        self._versions: collections.deque[Version] = collections.deque()
        self._stored = journal.streams()
        self._dirty: set[tuple[str, str]] = set(self._stored)
        self._next_ack = 0.0
        self._live: tuple[float, float] | None = None  # (newest event time, wall clock then) of events in step
        self.streams: Streams[Received] = Streams(dict(self._stored), limits.held_events_max, limits.streams_max)
        self.with_spool: set[str] = set()
        """Cameras whose publisher has been seen alive, so that it has a spool."""
        self._deadline: float | None = None
        self.rejects = Rejects()
        self.reason = ""
        """Why nothing is stored at the moment; "" if all is well."""
        self.counts = dict.fromkeys(("received", "stored", "duplicate", "future", "inbox_full", "held_full"), 0)
        self.cameras: dict[str, dict[str, float]] = {}
        self.gap = threading.Event()
        """Set when a gap appears: time to pull."""
        self._beat: Beat = no_beat

    def on_event(self, key: str, payload: bytes) -> None:
        """A publication on ``event/{camera}``. Never blocks: what does not fit is left to the spool."""
        try:
            self._inbox.put_nowait((key.removeprefix("event/"), payload))
        except queue.Full:
            self.counts["inbox_full"] += 1

    def on_pulled(self, pulled: Pulled) -> bool:
        """The answer of a spool; False if there is no room for it now."""
        if self._pulled_waiting >= _PULLED_MAX:
            return False
        try:
            self._inbox.put_nowait(pulled)
        except queue.Full:
            return False
        self._pulled_waiting += 1
        return True

    def on_version(self, version: Version) -> None:
        """A version from the learner, to be stored and then published. Never blocks."""
        self._versions.append(version)

    def on_deadline(self, deadline: float | None) -> None:
        """Event time at which the learner wants to be told that time went on."""
        self._deadline = deadline

    def use(self, limits: Limits) -> None:
        """Obey other limits from now on, as far as they are not the sizes of what exists. Any thread."""
        self._limits = limits

    def work(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Store until ``stopping``, then what is in the inbox already."""
        self._beat = beat
        while not stopping.is_set():
            self._round(self._take(), stopping)
            beat()
        self._round(self._take(), stopping)
        self._ack(now=float("inf"))

    def _round(self, messages: list[tuple[str, bytes] | Pulled], stopping: threading.Event) -> None:
        now = time.monotonic()
        ready: list[Received] = []
        for message in messages:
            if isinstance(message, Pulled):
                ready += self._pulled(message, now)
            else:
                ready += self._published(*message, now)
        ready += self.streams.give_up(now, self._limits.gap_seconds, self.with_spool)
        ready += self._time_went_on()
        self._store(ready, stopping)
        self._ack(now)
        if self.streams.gaps:
            self.gap.set()

    def _take(self) -> list[tuple[str, bytes] | Pulled]:
        """What came in, at most a transaction's worth and no more than the learner has room for."""
        room = min(self._limits.commit_events_max, self._room())
        if room <= 0:
            time.sleep(_TICK_SECONDS)
        messages: list[tuple[str, bytes] | Pulled] = []
        deadline = time.monotonic() + _TICK_SECONDS
        while room > 0:
            try:
                wait = max(0.0, deadline - time.monotonic())
                message = self._inbox.get(block=wait > 0, timeout=wait or None)
            except queue.Empty:
                break
            if not messages:
                deadline = min(deadline, time.monotonic() + self._limits.commit_seconds)
            if isinstance(message, Pulled):
                self._pulled_waiting -= 1
                room -= len(message.batch.events)
            else:
                room -= 1
            messages.append(message)
        return messages

    def _published(self, camera: str, raw: bytes, now: float) -> list[Received]:
        self.counts["received"] += 1
        try:
            event = decode(raw)
        except codec.Rejected as error:
            self.rejects.add(error.reason, f"event/{camera}", str(error), raw)
            return []
        if event.camera != camera:
            self.rejects.add("wrong-camera", f"event/{camera}", f"says camera {event.camera!r}", raw)
            return []
        received = self._judge(event, raw)
        if event.boot is None or event.seq is None:
            return [received]
        return self._order(camera, event.boot, event.seq, received, now)

    def _pulled(self, pulled: Pulled, now: float) -> list[Received]:
        batch = pulled.batch
        key = (batch.camera, batch.boot)
        ready = self.streams.begins_at(key, batch.first, now)
        for seq, raw in batch.events:
            received = Received(Entry("refused", batch.camera, batch.boot, seq, raw[: codec.EVENT_BYTES_MAX]))
            try:
                event = decode(raw)
                if (event.camera, event.boot, event.seq) == (batch.camera, batch.boot, seq):
                    received = self._judge(event, raw)
                else:
                    self.rejects.add("wrong-camera", f"spool/{batch.camera}", "says another stream", raw)
            except codec.Rejected as error:
                self.rejects.add(error.reason, f"spool/{batch.camera}", str(error), raw)
            ready += self._order(batch.camera, batch.boot, seq, received, now)
        self.streams.answered(key, pulled.asked_from)
        if key in self._stored and batch.first <= self._stored[key]:
            self._dirty.add(key)  # it has what is stored here already: the ack got lost
        return ready

    def _judge(self, event: Event, raw: bytes) -> Received:
        if event.t > self._clock() + self._limits.future_seconds_max:
            self.counts["future"] += 1
            self.rejects.add("future", f"event/{event.camera}", "t is ahead of this machine's clock", raw)
            return Received(Entry("future", event.camera, event.boot, event.seq, raw))
        return Received(Entry("event", event.camera, event.boot, event.seq, raw), event)

    def _order(self, camera: str, boot: str, seq: int, received: Received, now: float) -> list[Received]:
        verdict, ready = self.streams.offer((camera, boot), seq, received, now)
        if verdict == "duplicate":
            self.counts["duplicate"] += 1
        elif verdict == "dropped":
            self.counts["held_full"] += 1
        elif verdict == "refused":
            self.rejects.add("too-many-streams", f"event/{camera}", "limits.streams_max is reached", received.entry.raw)
        return ready

    def _time_went_on(self) -> list[Received]:
        """An advance, when events in step with the clock have stopped and the learner waits for time."""
        if self._live is None or self._deadline is None:
            return []
        newest, since = self._live
        wall = self._clock()
        now = wall - self._limits.settle_seconds
        if now < self._deadline or now <= newest or wall - since < self._limits.settle_seconds:
            return []
        self._live = (now, since)
        entry = Entry("advance", "", None, None, repr(now).encode())
        return [Received(entry, advance=now)]

    def _store(self, ready: list[Received], stopping: threading.Event) -> None:
        """Commit, however often it takes; then hand on. Gives up only when the daemon stops."""
        versions = [self._versions.popleft() for _ in range(len(self._versions))]
        digests = [(version.topology.version, version.topology.digest) for version in versions]
        while True:
            try:
                self._journal.commit([received.entry for received in ready], digests)
                break
            except sqlite3.Error as error:
                if not self.reason:
                    log.error("cannot write the journal, so nothing is acknowledged: %s", error)
                self.reason = f"cannot write the journal: {error}"
                self._beat()  # starting again would not help
                if stopping.wait(_RETRY_SECONDS):
                    return
        if self.reason:
            log.info("the journal can be written again")
            self.reason = ""
        wall = self._clock()
        for entry, event, _ in ready:
            if entry.boot is not None and entry.seq is not None:
                self._stored[entry.camera, entry.boot] = entry.seq
                self._dirty.add((entry.camera, entry.boot))
            if event is not None:
                self._note(event, wall)
        if ready:
            self._learn(ready)
        for version in versions:
            self._publish(version)

    def _note(self, event: Event, wall: float) -> None:
        self.counts["stored"] += 1
        if event.camera not in self.cameras and len(self.cameras) >= self._limits.streams_max:
            return
        camera = self.cameras.setdefault(event.camera, {"events": 0, "newest": event.t})
        camera["events"] += 1
        camera["newest"] = max(camera["newest"], event.t)
        if abs(event.t - wall) <= self._limits.future_seconds_max:
            newest = event.t if self._live is None else max(event.t, self._live[0])
            self._live = (newest, wall)

    def _ack(self, now: float) -> None:
        if now < self._next_ack:
            return
        self._next_ack = now + self._limits.ack_seconds
        for camera, boot in self._dirty:
            self._bus.put(f"ack/{camera}", Ack(camera, boot, self._stored[camera, boot]), "ack")
            self._beat()  # a put onto a dead link blocks for seconds
        self._dirty.clear()
