"""Merge what the shards of a site have learned into one topology with one sequence of versions.

It runs beside shard 0. A shard publishes ``part/{shard}`` after its own versions are stored, and
answers queries for it; lost updates are queried again. A version is stored, in a journal of its
own, before it is published, so it never has two contents. A missing shard does not delay the others
for long: its cameras stay as they were until it is back.
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
from camtopod.serve.learner_process import ShardUpdate
from camtopod.serve.runtime import Beat, no_beat
from camtopod.serve.runtime import clock as clocks
from camtopod.serve.storage import Journal, JournalWriter, Snapshot, Version
from camtopod.sharding import (
    Assignment,
    Sharding,
    VersionLine,
    VersionLineState,
    age_of,
    is_assigned,
)
from camtopod.topology import make_delta

log = logging.getLogger(__name__)

FOLDER = "site"
"""Folder of the state directory with the versions, and the parts they were made of."""
PATIENCE_SECONDS = 10.0
"""Time that a part waits for shards that have not reached its event time.

They may be missing, or there may be no traffic at their cameras.
"""
INBOX_MAX = 1_000
"""Most updates that wait; beyond it only the newest part of each district is kept."""
WAITING_PARTS_MAX = 10_000
"""Most parts that wait for a shard that is present but has not reached their event time."""
_TICK_SECONDS = 0.2


class SiteMerger:
    """Merges the updates of shards into the site's topology.

    Run `work` in a thread, and pass updates to `on_update`, from any thread.

    publish: called with each version after it is stored.
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
        self._storing = JournalWriter(self._journal, clock, clocks.steady_clock_for(clock), publish)
        self._clock, self._shards, self._dealing = clock, shards, Assignment(sharding)
        self._inbox: list[ShardUpdate] = []
        self._came = threading.Condition()
        self._reached: dict[int, float | None] = {}  # event time by shard
        self._line = VersionLine(settings, site, "")
        with contextlib.ExitStack() as undo:  # close the journal if the start fails
            undo.callback(self._journal.close)
            self._load()
            undo.pop_all()
        self._known = {part.district: age_of(part) for part in self._line.parts()}
        now = time.monotonic()
        # Parts by time of arrival (monotonic), with their event times.
        self._arrivals = collections.deque(
            (now, part.topology.as_of) for part in self._line.parts()
        )

    @property
    def topology(self) -> Topology | None:
        """The newest version."""
        return self._line.topology

    @property
    def reason(self) -> str:
        """Why nothing is stored at the moment; "" if it is."""
        return self._storing.reason

    def on_update(self, key: str, payload: bytes) -> None:
        """Take a publication on ``part/{shard}``, or the answer to a query for it.

        Invalid ones are logged and ignored.
        """
        try:
            told = codec.read(ShardUpdate, payload, pack=True)
        except codec.Rejected as error:
            log.error("an update on %s is invalid and is ignored: %s", key, error)
            return

        # It must be of this site, and assigned in the same way.
        if told.shards != self._shards or key != f"part/{told.shard}":
            log.error(
                "an update of shard %d of %d is ignored: this site has %d shards; start all its"
                " daemons with the same number",
                told.shard,
                told.shards,
                self._shards,
            )
            return
        if not all(is_assigned(part, self._dealing) for part in told.parts):
            log.error(
                "shard %d has different [shards] settings; all shards of a site must agree",
                told.shard,
            )
            return
        self.add_update(told)

    def add_update(self, told: ShardUpdate) -> None:
        """Take an update of a shard. Any thread; never blocks."""
        with self._came:
            self._inbox.append(told)
            if len(self._inbox) > INBOX_MAX:
                self._inbox = _newest_updates(self._inbox)
            self._came.notify_all()

    def work(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Merge until ``stopping``."""
        while not stopping.is_set():
            with self._came:
                if not self._inbox:
                    self._came.wait(_TICK_SECONDS)
                told, self._inbox = self._inbox, []
            self._take_updates(told)
            self._make_versions(stopping, beat)
            beat()

    def version(self, epoch: str, version: int) -> bytes | None:
        """Return an older version as JSON; None if it is not kept."""
        return self._journal.version(epoch, version)

    def close(self) -> None:
        """Close the journal; only after `work` has ended."""
        self._journal.close()

    def _load(self) -> None:
        """Continue from the stored state, without parts that are now assigned to other districts.

        A new epoch begins if the state cannot be used, or is older than the newest version, which
        would otherwise get two contents.
        """
        # Load the newest snapshot that can be read.
        epoch = self._journal.meta("epoch")
        for snapshot in self._journal.snapshots():
            try:
                state = codec.read(VersionLineState, snapshot.state, pack=True)
                state.parts = [part for part in state.parts if is_assigned(part, self._dealing)]
                state.waiting = [part for part in state.waiting if is_assigned(part, self._dealing)]
                self._line.load(state)
                break
            except codec.Rejected as error:
                log.error("the snapshot at version %d cannot be read: %s", snapshot.position, error)

        # Begin an epoch if it is not that of the newest version.
        newest = 0 if epoch is None else max(self._journal.versions(epoch), default=0)
        known = self._line.topology
        if epoch is None or (self._line.epoch, known.version if known else 0) != (epoch, newest):
            epoch = clocks.ulid(
                self._clock(), after=epoch or self._journal.meta("epoch before") or ""
            )
            self._journal.set_meta("epoch", epoch)
            self._line.begin_epoch(epoch)
            log.info("the site's topology: epoch %s begins", epoch)

    def _take_updates(self, told: Iterable[ShardUpdate]) -> None:
        """Take the parts that are new, and the progress of the shards."""
        now = time.monotonic()
        for one in told:
            for part in one.parts:
                if self._known.get(part.district, (-math.inf, 0)) < age_of(part):
                    self._known[part.district] = age_of(part)
                    self._line.take([part])
                    self._arrivals.append((now, part.topology.as_of))
            self._reached[one.shard] = one.reached

    def _make_versions(self, stopping: threading.Event, beat: Beat) -> None:
        """Make, store and publish the versions that are due."""
        # Make them.
        before = self._line.topology
        self._line.refresh()
        self._line.reach(self._waited_for_until(time.monotonic()))
        made = self._line.updates()

        # Store them, with the state after the last one.
        for topology in made:
            delta = None if before is None else codec.to_msgpack(make_delta(before, topology))
            self._storing.on_version(Version.of(topology, delta))
            before = topology
        if made:
            state = msgspec.msgpack.encode(self._line.save())
            self._storing.on_snapshot(Snapshot(made[-1].version, made[-1].epoch, state))
        self._storing.store([], stopping, beat)  # also checks that the journal is still there
        self._storing.prune()

    def _waited_for_until(self, now: float) -> float:
        """Return the event time up to which no shard is waited for any more."""
        # Parts that have waited long enough.
        waited_for = -math.inf
        while self._arrivals and now - self._arrivals[0][0] > PATIENCE_SECONDS:
            waited_for = max(waited_for, self._arrivals.popleft()[1])

        # With too many waiting parts, wait for none.
        if self._line.waiting > WAITING_PARTS_MAX:
            return math.inf

        # Otherwise wait until all shards have reached an event time.
        reached = [self._reached.get(shard) for shard in range(self._shards)]
        marks = [mark for mark in reached if mark is not None]
        return max(waited_for, min(marks)) if len(marks) == self._shards else waited_for


def _newest_updates(told: Iterable[ShardUpdate]) -> list[ShardUpdate]:
    """Return one update for each shard, with the newest part of each of its districts."""
    shards: dict[int, ShardUpdate] = {}
    for one in told:
        before = shards.get(one.shard, ShardUpdate(one.shard, one.shards, None))
        parts = {part.district: part for part in sorted((*before.parts, *one.parts), key=age_of)}
        shards[one.shard] = msgspec.structs.replace(one, parts=list(parts.values()))
    return list(shards.values())
