"""The parts of a site that several daemons learn, put together: one topology with one version line.

It runs beside shard 0. A shard publishes ``part/{shard}`` after its own versions are stored, and
answers questions for it; what is lost on the way is asked for again. A version is stored before it
is published, in a journal of its own, so it never has two contents. A shard that is away holds
nobody up for long: its cameras stay as they were until it is back.
"""

from __future__ import annotations

import collections
import contextlib
import logging
import math
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import msgspec

from camtopod import codec
from camtopod.config import KeepSettings
from camtopod.learn import Settings
from camtopod.records import Topology
from camtopod.serve.learner_process import Told
from camtopod.serve.runtime import Beat, no_beat
from camtopod.serve.runtime import clock as clocks
from camtopod.serve.storage import Journal, Snapshot, Storing, Version
from camtopod.sharding import Dealing, Line, LineState, Sharding, age_of, is_dealt
from camtopod.topology import make_delta

log = logging.getLogger(__name__)

FOLDER = "site"
"""Of the state directory: where versions and what they were made of are kept."""
PATIENCE_SECONDS = 10.0
"""So long a part waits for shards that have not come so far: they may be away, or nobody walk at
their cameras.
"""
INBOX_MAX = 1_000
"""Messages of shards that wait; of more only the newest part of each district is kept."""
WAITING_PARTS_MAX = 10_000
"""Parts that wait for a shard which is there but has not come so far; with more it is not waited
for.
"""
_TICK_SECONDS = 0.2


class Merger:
    """Give it what shards say with `on_part` (any thread), and run `work` in a thread. ``publish``
    is called with each version after it is stored.
    """

    def __init__(
        self,
        directory: Path,
        keep: KeepSettings,
        settings: Settings,
        site: str,
        sharding: Sharding,
        shards: int,
        clock: clocks.Clock,
        publish: Callable[[Version], None],
    ) -> None:
        self._journal = Journal(directory / FOLDER, keep)
        self._storing = Storing(self._journal, clock, clocks.steady_beside(clock), publish)
        self._clock, self._shards, self._dealing = clock, shards, Dealing(sharding)
        self._inbox: list[Told] = []
        self._came = threading.Condition()
        self._reached: dict[int, float | None] = {}  # event time by shard
        self._line = Line(settings, site, "")
        with contextlib.ExitStack() as undo:  # a start that fails leaves nothing open
            undo.callback(self._journal.close)
            self._load()
            undo.pop_all()
        self._known = {part.district: age_of(part) for part in self._line.parts()}
        now = time.monotonic()
        self._arrivals = collections.deque(
            (now, part.topology.as_of) for part in self._line.parts()
        )  # of parts

    @property
    def topology(self) -> Topology | None:
        """The newest version."""
        return self._line.topology

    @property
    def reason(self) -> str:
        """Why nothing is stored at the moment; "" if all is well."""
        return self._storing.reason

    def on_part(self, key: str, payload: bytes) -> None:
        """A publication on ``part/{shard}``, or the answer to a question for it."""
        try:
            told = codec.read_in_parts(Told, payload)
        except codec.Rejected as error:
            log.error("what came on %s cannot be read: %s", key, error)
            return
        if told.shards != self._shards or key != f"part/{told.shard}":
            log.error(
                "shard %d of %d is none of this site's %d", told.shard, told.shards, self._shards
            )
            return
        if not all(is_dealt(part, self._dealing) for part in told.parts):
            log.error(
                "shard %d has dealt out the site otherwise: all need the same [shards] settings",
                told.shard,
            )
            return
        self.tell(told)

    def tell(self, told: Told) -> None:
        """What a shard has to say. Any thread; never blocks."""
        with self._came:
            self._inbox.append(told)
            if len(self._inbox) > INBOX_MAX:
                self._inbox = _newest(self._inbox)
            self._came.notify_all()

    def work(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Merge until ``stopping``."""
        while not stopping.is_set():
            with self._came:
                if not self._inbox:
                    self._came.wait(_TICK_SECONDS)
                told, self._inbox = self._inbox, []
            self._take(told)
            self._make(stopping, beat)
            beat()

    def version(self, epoch: str, version: int) -> bytes | None:
        """An older version as JSON; None if it is not kept."""
        return self._journal.version(epoch, version)

    def close(self) -> None:
        """Only after `work` has ended."""
        self._journal.close()

    def _load(self) -> None:
        """Go on from what is stored, without parts of a site that was dealt out otherwise. A new
        epoch begins where it cannot be used, or is older than the newest version, which would have
        two contents otherwise.
        """
        epoch = self._journal.meta("epoch")
        for snapshot in self._journal.snapshots():
            try:
                state = codec.read(LineState, snapshot.state, pack=True)
                state.parts = [part for part in state.parts if is_dealt(part, self._dealing)]
                state.waiting = [part for part in state.waiting if is_dealt(part, self._dealing)]
                self._line.load(state)
                break
            except codec.Rejected as error:
                log.error(
                    "what version %d was made of cannot be read: %s", snapshot.position, error
                )
        newest = 0 if epoch is None else max(self._journal.versions(epoch), default=0)
        known = self._line.topology
        if epoch is None or (self._line.epoch, known.version if known else 0) != (epoch, newest):
            epoch = clocks.ulid(
                self._clock(), after=epoch or self._journal.meta("epoch before") or ""
            )
            self._journal.set_meta("epoch", epoch)
            self._line.begin_epoch(epoch)
            log.info("the site's topology: epoch %s begins", epoch)

    def _take(self, told: Iterable[Told]) -> None:
        now = time.monotonic()
        for one in told:
            for part in one.parts:
                if self._known.get(part.district, (-math.inf, 0)) < age_of(part):
                    self._known[part.district] = age_of(part)
                    self._line.take([part])
                    self._arrivals.append((now, part.topology.as_of))
            self._reached[one.shard] = one.reached

    def _make(self, stopping: threading.Event, beat: Beat) -> None:
        """The versions that are due, stored and published."""
        before = self._line.topology
        self._line.refresh()
        self._line.reach(self._until(time.monotonic()))
        made = self._line.updates()
        for topology in made:
            delta = None if before is None else codec.to_pack(make_delta(before, topology))
            self._storing.on_version(Version.of(topology, delta))
            before = topology
        if made:
            state = msgspec.msgpack.encode(self._line.save())
            self._storing.on_snapshot(Snapshot(made[-1].version, made[-1].epoch, state))
        self._storing.store([], stopping, beat)  # also looks whether the journal is still there
        self._storing.forget_old()

    def _until(self, now: float) -> float:
        """Event time up to which nobody is waited for any more."""
        waited_for = -math.inf
        while self._arrivals and now - self._arrivals[0][0] > PATIENCE_SECONDS:
            waited_for = max(waited_for, self._arrivals.popleft()[1])
        if self._line.waiting > WAITING_PARTS_MAX:
            return math.inf
        reached = [self._reached.get(shard) for shard in range(self._shards)]
        marks = [mark for mark in reached if mark is not None]
        return max(waited_for, min(marks)) if len(marks) == self._shards else waited_for


def _newest(told: Iterable[Told]) -> list[Told]:
    """All that matters of what several shards have said: a message for each."""
    shards: dict[int, Told] = {}
    for one in told:
        before = shards.get(one.shard, Told(one.shard, one.shards, None))
        parts = {part.district: part for part in sorted((*before.parts, *one.parts), key=age_of)}
        shards[one.shard] = msgspec.structs.replace(one, parts=list(parts.values()))
    return list(shards.values())
