"""The learner in a thread of its own, so that a refit holds nothing up: first what the journal has beyond the
snapshot, then what comes.
"""

from __future__ import annotations

import logging
import queue
import sqlite3
import threading
from collections.abc import Callable

from camtopod.learn.snapshot import pack
from camtopod.learn.topology import make_delta
from camtopod.records import Event, Topology
from camtopod.serve import memory
from camtopod.serve.cameras import Received
from camtopod.serve.journal import Journal, Snapshot
from camtopod.serve.progress import Beat, no_beat
from camtopod.serve.recovery import Recovered, note_failure, received
from camtopod.serve.storing import Version

log = logging.getLogger(__name__)

_TICK_SECONDS = 0.2
_PROGRESS_ENTRIES = 200_000

Lesson = Event | float | None
"""What an entry of the journal teaches: an event, that event time has come so far, nothing."""


class Learning:
    """Feeds a learner. Its thread gives each new version to ``on_version``, snapshots to ``on_snapshot`` (each after
    the versions it has in it), and the deadline to ``on_deadline``; ``new_epoch`` begins and stores an epoch.
    """

    def __init__(
        self,
        recovered: Recovered,
        journal: Journal,
        events_max: int,
        snapshot_events: int,
        on_version: Callable[[Version], None],
        on_snapshot: Callable[[Snapshot], None],
        on_deadline: Callable[[float | None], None],
        new_epoch: Callable[[], str],
    ) -> None:
        self._learner, self.position, self.epoch = recovered
        self._journal = journal
        self._events_max, self._snapshot_events = events_max, snapshot_events
        self._on_version, self._on_snapshot, self._on_deadline = on_version, on_snapshot, on_deadline
        self._new_epoch = new_epoch
        self._stored = journal.versions(self.epoch)
        self._newest_stored = max(self._stored, default=0)
        self._replay_until = len(journal)
        self._saved = self.position
        self._due = False
        self._queue: queue.SimpleQueue[list[Lesson]] = queue.SimpleQueue()
        self._waiting = 0
        self._mutex = threading.Lock()
        self._topology = self._learner.topology
        self.damaged = 0
        """Damaged entries of the journal that were left out."""
        self.statistics = self._learner.statistics()
        """The learner's, as of its last step."""
        on_deadline(self._learner.next_deadline())

    def feed(self, batch: list[Received]) -> None:
        """Learn these, in this order, soon. Any thread."""
        with self._mutex:
            self._waiting += len(batch)
        self._queue.put([_lesson(one) for one in batch])

    def room(self) -> int:
        """How many events may be fed at the moment."""
        return self._events_max - self._waiting

    @property
    def waiting(self) -> int:
        """Events stored and not learned yet."""
        return self._waiting + self.replaying

    @property
    def replaying(self) -> int:
        """Entries of before the start that are not learned yet."""
        return max(0, self._replay_until - self.position)

    def work(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Learn until ``stopping``; what is not learned by then is in the journal."""
        failed = True
        try:
            self._catch_up(stopping, beat)
            self._go_on(stopping, beat)
            failed = False
        except (sqlite3.Error, OSError):  # the disk's failure, not the learner's
            failed = False
            raise
        finally:
            if failed:
                note_failure(self._journal, self.position + 1)

    def snapshot(self) -> Snapshot | None:
        """The learner as it is, for the next start; None if nothing has been learned since the last. Only while `work`
        does not run.
        """
        if self.position == self._saved and not self._due:
            return None
        return Snapshot(self.position, self.epoch, pack(self._learner.save()))

    def _catch_up(self, stopping: threading.Event, beat: Beat) -> None:
        begun = self.position
        self._learner.refresh()
        self._take_versions()
        for number, entry in self._journal.entries(after=begun, up_to=self._replay_until):
            if stopping.is_set():
                return
            self.position = number - 1
            if entry is None:
                self.damaged += 1
            else:
                self._learn(_lesson(received(entry)))
            self.position = number
            beat()
            if (number - begun) % _PROGRESS_ENTRIES == 0:
                log.info("replayed %d of %d journal entries", number - begun, self._replay_until - begun)
        self.position = max(self.position, self._replay_until)
        if self.damaged:
            log.error("%d damaged entries of the journal are left out; they are still in the file", self.damaged)
        self._tell()

    def _go_on(self, stopping: threading.Event, beat: Beat) -> None:
        while not stopping.is_set():
            try:
                batch = self._queue.get(timeout=_TICK_SECONDS)
            except queue.Empty:
                beat()
                continue
            for lesson in batch:
                self._learn(lesson)
                self.position += 1
                beat()
                if stopping.is_set():
                    return
            with self._mutex:
                self._waiting -= len(batch)
            self._tell()

    def _learn(self, lesson: Lesson) -> None:
        """One committed entry into the learner, new versions out."""
        if isinstance(lesson, Event):
            self._learner.receive(lesson)
        elif lesson is not None:
            self._learner.advance(lesson)
        self._take_versions()

    def _take_versions(self) -> None:
        while made := self._learner.updates():
            for topology in made:
                self._hand_out(topology)

    def _hand_out(self, topology: Topology) -> None:
        """A version that is stored already must come out as it was, one that was and is not kept any more is passed
        over; a new one is handed on.
        """
        if topology.epoch != self.epoch:
            return  # made in the same step as the one that ended its epoch
        stored = self._stored.pop(topology.version, None)
        if stored is not None and stored != topology.digest:
            self.epoch, self._stored, self._newest_stored, self._topology = self._new_epoch(), {}, 0, None
            log.warning(
                "version %d comes out otherwise than it was (another program or processor?): epoch %s begins",
                topology.version, self.epoch,
            )  # fmt: skip
            self._learner.begin_epoch(self.epoch)
            self._learner.refresh()
            return
        delta = None if self._topology is None else make_delta(self._topology, topology)
        self._topology = topology
        if topology.version > self._newest_stored:
            self._due = True
            self._on_version(Version(topology, delta))

    def _tell(self) -> None:
        """Between batches: a snapshot if one is due, and how things are."""
        if self._due:
            memory.give_back()  # a fit takes a lot for a moment
        if self._due or self.position - self._saved >= self._snapshot_events:
            snapshot = self.snapshot()
            if snapshot is not None:
                self._on_snapshot(snapshot)
                self._saved, self._due = self.position, False
        self.statistics = self._learner.statistics()
        self._on_deadline(self._learner.next_deadline())


def _lesson(one: Received) -> Lesson:
    """Without the entry and its bytes, which are stored: thousands wait while a version is made."""
    return one.advance if one.event is None else one.event
