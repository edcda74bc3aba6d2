"""What the learner is taught, in what order, and what becomes of it: what the journal has beyond
the snapshot, then what comes, and again from the journal what has come meanwhile when that is more
than is kept in memory. The learning itself is done in a process of its own, so that a refit holds
nothing up; order, ledger and failures are looked after here.
"""

from __future__ import annotations

import contextlib
import logging
import math
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator

from camtopod.serve.ingest import Received
from camtopod.serve.learner_process.messages import (
    LESSONS_MAX,
    OUT_OF_MEMORY,
    Answer,
    Lesson,
    Made,
    NewEpoch,
    Otherwise,
    Question,
    Refresh,
    Save,
    Saved,
    Taught,
    Teach,
)
from camtopod.serve.learner_process.process import LearnerEnded, LearnerProcess
from camtopod.serve.learner_process.recovery import Recovered, note_failure
from camtopod.serve.runtime import Beat, memory, no_beat
from camtopod.serve.storage import Entry, Journal, Snapshot, Version, head_of, read_rewind

log = logging.getLogger(__name__)

FINISH_SECONDS = 3.0
"""When the daemon stops, a step may take so long yet. What is not learned is in the journal."""
SAVE_SECONDS_MAX = 3.0
"""And the snapshot of the end."""
GATHER_SECONDS = 0.02
"""What comes within this time is taught together: a message for each event would cost more than
learning it.
"""
QUEUED_EVENTS_MAX = 20_000
"""Kept in memory for the learner, beside the journal, from which what is more is read again."""
THOROUGH_EVERY = 250
"""Versions until it is looked for what would otherwise stay in memory for ever; it holds everything
up for a moment.
"""
GIVE_WAY_SECONDS = 0.0001
"""Whoever wants the interpreter while a version is made ready has it after this; a prediction wants
it often.
"""
REFUSED_SECONDS = 60.0
"""It is said that cameras are refused for so long after an event of one."""
_TICK_SECONDS = 0.2
_PROGRESS_ENTRIES = 200_000


class Learning:
    """Teaches the learner of ``process``, for which it is the only one to ask. Its thread gives
    each new version to ``on_version``, and whether that is hurried; snapshots to ``on_snapshot``
    (each after the versions it has in it), and the deadline to ``on_deadline``; ``new_epoch``
    begins and stores an epoch.
    """

    def __init__(
        self,
        recovered: Recovered,
        process: LearnerProcess,
        journal: Journal,
        events_max: int,
        snapshot_events: int,
        on_version: Callable[[Version, bool], None],
        on_snapshot: Callable[[Snapshot], None],
        on_deadline: Callable[[float | None], None],
        new_epoch: Callable[[], str],
    ) -> None:
        self.position, self.epoch, taught, self.left_out = recovered
        self._process, self._journal = process, journal
        self._events_max, self._snapshot_events = events_max, snapshot_events
        self._on_version, self._on_snapshot, self._on_deadline = (
            on_version,
            on_snapshot,
            on_deadline,
        )
        self._new_epoch = new_epoch
        self._replay_until = self._stored = len(journal)
        self._saved = self.position
        self._due = False
        self._busy = False  # whether the process owes an answer
        self._queue: queue.SimpleQueue[list[Lesson]] = queue.SimpleQueue()
        self._queued = 0
        self._behind = True  # whether what comes behind the queue is to be read from the journal
        self._mutex = threading.Lock()
        self.damaged = 0
        """Damaged entries of the journal that were left out."""
        self.statistics = taught.statistics
        """The learner's, as of its last step."""
        self.reached = taught.reached
        """Of a shard: event time up to which all versions before `made` have everything."""
        self.strangers = frozenset(taught.strangers or ())
        """Of a shard: cameras of other shards that it need not hear, but as guests."""
        self._refused_at = -math.inf
        self.made = 0
        """Versions handed over."""
        on_deadline(taught.deadline)

    def feed(self, batch: list[Received]) -> None:
        """Learn these, which have just been stored, in this order, soon. Any thread."""
        with self._mutex:
            self._stored += len(batch)
            self._behind = self._behind or self._queued + len(batch) > QUEUED_EVENTS_MAX
            if self._behind:
                return
            self._queued += len(batch)
        self._queue.put(
            [one.entry.raw if one.event is not None else one.rewind or one.advance for one in batch]
        )

    def room(self) -> int:
        """How many events may be fed at the moment."""
        return self._events_max - self.waiting

    @property
    def waiting(self) -> int:
        """Events stored and not learned yet."""
        return max(0, self._stored - self.position)

    @property
    def replaying(self) -> int:
        """Entries of before the start that are not learned yet."""
        return max(0, self._replay_until - self.position)

    @property
    def crowded(self) -> str:
        """Why some cameras are stored and not learned, and what to do; "" if none is. Any
        thread.
        """
        if time.monotonic() - self._refused_at > REFUSED_SECONDS:
            return ""
        return (
            "there are more cameras than learn.cameras_max: events of further ones are stored and not learned until "
            "another has been silent for an hour; if all are cameras of this site, raise learn.cameras_max"
        )

    def work(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Teach until ``stopping``; what is not learned by then is in the journal. Raises
        `LearnerEnded`.
        """
        try:
            self._learn(Refresh(self.position), stopping, beat)
            while not stopping.is_set():
                if self._queued == 0 and self._behind:
                    self._catch_up(stopping, beat)
                else:
                    self._go_on(stopping, beat)
        except LearnerEnded as ended:
            if stopping.is_set():
                return
            if ended.at:
                killed, out_of_memory = (
                    ended.status == -signal.SIGKILL,
                    ended.status == OUT_OF_MEMORY,
                )
                note_failure(self._journal, ended.at, killed, out_of_memory)
            raise

    def snapshot(self) -> Snapshot | None:
        """The learner as it is, for the next start; None if nothing has been learned since the
        last, or if it is in the middle of something. Only while `work` does not run.
        """
        if self._busy or (self.position == self._saved and not self._due):
            return None
        try:
            saved = self._process.ask(Save(), SAVE_SECONDS_MAX)
        except LearnerEnded as ended:
            log.warning("what was learned last has to be learned again from the journal: %s", ended)
            return None
        assert isinstance(saved, Saved)
        return Snapshot(self.position, self.epoch, saved.state)

    def _catch_up(self, stopping: threading.Event, beat: Beat) -> None:
        """What is stored by now, from the journal; nothing is queued meanwhile."""
        begun, until, damaged = self.position, self._stored, self.damaged
        batch: list[Lesson] = []
        for number, entry in self._journal.entries(after=begun, up_to=until):
            if not batch:
                self.position = number - 1
            self.damaged += entry is None
            batch.append(None if entry is None else self._lesson(number, entry))
            if len(batch) >= LESSONS_MAX or number == until:
                self._learn(Teach(self.position, batch), stopping, beat)
                self._tell(stopping, beat)
                batch = []
            if stopping.is_set():
                return
            if (number - begun) % _PROGRESS_ENTRIES == 0:
                log.info("replayed %d of %d journal entries", number - begun, until - begun)
        self.position = max(self.position, until)
        if self.damaged > damaged:
            log.error(
                "%d damaged entries of the journal are left out; they are still in the file",
                self.damaged,
            )
        with self._mutex:
            self._behind = self.position < self._stored
        self._tell(stopping, beat)

    def _go_on(self, stopping: threading.Event, beat: Beat) -> None:
        """What is queued, or wait for something."""
        try:
            batch = self._queue.get(timeout=_TICK_SECONDS)
        except queue.Empty:
            self._process.check()
            beat()
            return
        if len(batch) < LESSONS_MAX:
            stopping.wait(GATHER_SECONDS)
        while len(batch) < LESSONS_MAX and not self._queue.empty():
            batch += self._queue.get()
        for first in range(0, len(batch), LESSONS_MAX):
            some = batch[first : first + LESSONS_MAX]
            self._learn(Teach(self.position, some), stopping, beat)
            with self._mutex:
                self._queued -= len(some)
            beat()
            if stopping.is_set():
                return
        self._tell(stopping, beat)

    def _learn(self, task: Refresh | Teach, stopping: threading.Event, beat: Beat) -> None:
        """What there is to learn into the learner, new versions out."""
        taught = self._ask(task, stopping, beat)
        assert isinstance(taught, Taught)
        if taught.statistics.get("refused", 0) > self.statistics.get("refused", 0):
            self._refused_at = time.monotonic()
        self.position, self.statistics, self.epoch = (
            taught.position,
            taught.statistics,
            taught.epoch,
        )
        self.reached = taught.reached
        if taught.strangers is not None:
            self.strangers = frozenset(taught.strangers)
        self._on_deadline(taught.deadline)
        if taught.unreadable:
            log.error("%d entries of the journal cannot be read any more", taught.unreadable)

    def _lesson(self, number: int, entry: Entry) -> Lesson:
        """Without what surrounds it, which is stored: thousands wait while a version is made."""
        match entry.kind:
            case "event" if number > self.left_out.get(entry.camera, 0):
                return entry.raw
            case "advance":
                return float(entry.raw)
            case "rewind":
                return read_rewind(entry, self._journal.versions)
            case _:
                return None

    def _tell(self, stopping: threading.Event, beat: Beat) -> None:
        """Between batches: a snapshot if one is due."""
        if self._due or self.position - self._saved >= self._snapshot_events:
            saved = self._ask(Save(), stopping, beat)
            assert isinstance(saved, Saved)
            self._on_snapshot(Snapshot(self.position, self.epoch, saved.state))
            self._saved, self._due = self.position, False
            memory.give_back()

    def _ask(self, question: Question, stopping: threading.Event, beat: Beat) -> Answer:
        """Everything it has to say about that; it gets on when it is at another entry. Raises
        `LearnerEnded`.
        """
        self._busy = True
        self._process.send(question)
        told_at = None
        while True:
            answer = self._process.receive(_TICK_SECONDS)
            if isinstance(answer, Made):
                self._take(answer)
            elif isinstance(answer, Otherwise):
                self._begin_epoch(answer.version)
            elif answer is not None:
                self._busy = False
                return answer
            if answer is not None or self._process.got_on():
                beat()
            if stopping.is_set():
                told_at = told_at or time.monotonic()
                self._process.hurry()
                if time.monotonic() - told_at > FINISH_SECONDS:
                    self._process.kill()

    def _take(self, made: Made) -> None:
        """A new version. It may take its time, unless the journal is replayed and one comes after
        the other.
        """
        self._due = True
        self.made += 1
        with _giving_way(), memory.kept(thorough=self.made % THOROUGH_EVERY == 0):
            version = Version(
                head_of(made.packed), made.content, made.packed, made.delta, made.told
            )
            self._on_version(version, self.replaying > 0)

    def _begin_epoch(self, version: int) -> None:
        self.epoch = self._new_epoch()
        log.warning(
            "version %d comes out otherwise than it was (another program or processor?): epoch %s begins",
            version,
            self.epoch,
        )
        self._process.send(NewEpoch(self.epoch))


@contextlib.contextmanager
def _giving_way() -> Iterator[None]:
    """What takes a tenth of a second, in a thread beside which others have little to do, but that
    at once.
    """
    usual = sys.getswitchinterval()
    sys.setswitchinterval(min(usual, GIVE_WAY_SECONDS))
    try:
        yield
    finally:
        sys.setswitchinterval(usual)
