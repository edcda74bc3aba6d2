"""Feed the journal's entries to the learner, and take its versions.

They are read from the journal as they are stored, beginning behind the snapshot. The learner runs
in its own process, so that a refit delays nothing here; order, position and failures are looked
after on this side.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from camtopod import codec
from camtopod.records import CatchingUp, Topology
from camtopod.serve.learner_process.messages import (
    INPUTS_MAX,
    Input,
    Kind,
    LearnBatch,
    LearnProgress,
    NewEpoch,
    NewVersion,
    Question,
    Save,
    Saved,
    VersionMismatch,
)
from camtopod.serve.learner_process.process import LearnerEnded, LearnerProcess
from camtopod.serve.learner_process.recovery import Recovered, note_failure
from camtopod.serve.runtime import Beat, no_beat
from camtopod.serve.storage import Journal, Snapshot, Version

log = logging.getLogger(__name__)

FINISH_SECONDS = 3.0
"""Time that a step, and the snapshot at the end, may still take when the daemon stops."""
GATHER_SECONDS = 0.02
"""Time in which new events are gathered into one message.

A message for each event would cost more than learning it.
"""
CATCHING_UP_SECONDS = 180.0
"""Event time by which the learner may be behind the newest stored event until it is catching up.

A fit takes this long on a large site, and a camera's clock may be a minute ahead.
"""
SNAPSHOT_ENTRIES = 20_000
"""Number of entries after which the learner's state is saved; also after every version."""
_TICK_SECONDS = 0.2


class LearnerFeeder:
    """Feeds the learner of ``process``; nothing else may ask that process.

    The thread of `work` calls:

    on_version: with each new version.
    on_snapshot: with each snapshot, after the versions it includes.
    on_deadline: with the event time that the learner waits for.
    new_epoch: to begin and store an epoch.
    snapshot_entries: number of entries after which the learner's state is saved.
    """

    def __init__(
        self,
        recovered: Recovered,
        process: LearnerProcess,
        journal: Journal,
        on_version: Callable[[Version], None],
        on_snapshot: Callable[[Snapshot], None],
        on_deadline: Callable[[float | None], None],
        new_epoch: Callable[[], str],
        snapshot_entries: int = SNAPSHOT_ENTRIES,
    ) -> None:
        self.position = recovered.position
        self.epoch = recovered.epoch
        self._process = process
        self._journal = journal
        self._on_version = on_version
        self._on_snapshot = on_snapshot
        self._on_deadline = on_deadline
        self._new_epoch = new_epoch
        self._replay_until = len(journal)
        self._saved = self.position
        self._up_to_date_at = self.position
        self._due = False
        self._snapshot_entries = snapshot_entries
        self._busy = False  # True while the process owes an answer
        self._stored = threading.Event()
        self.damaged = 0
        """Number of damaged journal entries that were left out."""
        self.statistics = recovered.progress.statistics
        """The learner's statistics, as of its last step."""
        on_deadline(recovered.progress.deadline)

    def note_stored(self) -> None:
        """Entries have just been stored, to be learned soon. Any thread."""
        self._stored.set()

    @property
    def waiting(self) -> int:
        """Number of entries stored and not learned yet."""
        return max(0, len(self._journal) - self.position)

    @property
    def replaying(self) -> int:
        """Number of entries from before the start that are not learned yet."""
        return max(0, self._replay_until - self.position)

    def catching_up(self, newest: float) -> CatchingUp | None:
        """Return how far the learner is behind; None if it is up to date. Any thread.

        ``seconds``: event time that is stored and not learned yet.
        ``share``: events learned, of those stored since this was last asked of a learner that was
        up to date.

        newest: event time of the newest event stored, Unix seconds.
        """
        watermark = self.statistics["watermark"]
        seconds = newest - watermark if watermark else 0.0  # it has none before its first events
        waiting = self.waiting
        if not waiting or seconds < CATCHING_UP_SECONDS:
            self._up_to_date_at = self.position
            return None
        learned = self.position - self._up_to_date_at
        return CatchingUp(seconds, max(0.0, learned / max(1, learned + waiting)))

    def work(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Feed the learner until ``stopping``; entries not learned by then are in the journal.

        Raises `LearnerEnded`.
        """
        try:
            self._learn(LearnBatch(self.position, []), stopping, beat)
            while not stopping.is_set():
                if not self.waiting and not self._stored.wait(_TICK_SECONDS):
                    self._process.check()
                elif self._stored.is_set():
                    stopping.wait(GATHER_SECONDS)
                self._stored.clear()
                self._learn_stored(stopping, beat)
                beat()
        except LearnerEnded as ended:
            if stopping.is_set():
                return

            # Note the entry at which the learner failed, for the next start.
            if ended.at:
                note_failure(self._journal, ended.at)
            raise

    def snapshot(self) -> Snapshot | None:
        """Return the learner's state for the next start; only while `work` does not run.

        None if nothing has been learned since the last snapshot, or if the learner is in the middle
        of a step.
        """
        if self._busy or (self.position == self._saved and not self._due):
            return None
        try:
            saved = self._process.ask(Save(), Saved, FINISH_SECONDS)
        except LearnerEnded as ended:
            log.warning(
                "the learner's last state is not saved, so the next start repeats some entries of"
                " the journal: %s",
                ended,
            )
            return None
        return Snapshot(self.position, self.epoch, saved.state)

    def _learn_stored(self, stopping: threading.Event, beat: Beat) -> None:
        """Learn what the journal has by now, in batches."""
        until = len(self._journal)
        damaged = self.damaged
        batch: list[Input] = []
        for number, entry in self._journal.entries(after=self.position, up_to=until):
            if not batch:
                self.position = number - 1
            self.damaged += entry is None
            batch.append(("skipped", b"") if entry is None else (entry.kind, entry.raw))
            if len(batch) >= INPUTS_MAX or number == until:
                self._learn(LearnBatch(self.position, batch), stopping, beat)
                self._take_snapshot(stopping, beat)
                batch = []
            if stopping.is_set():
                return
        self.position = max(self.position, until)
        if self.damaged > damaged:
            log.error(
                "%d damaged entries of the journal are not learned; they are still in the file",
                self.damaged,
            )

    def _learn(self, task: LearnBatch, stopping: threading.Event, beat: Beat) -> None:
        """Send a task to the learner and note the progress."""
        progress = self._ask(task, LearnProgress, stopping, beat)
        self.position = progress.position
        self.statistics = progress.statistics
        self.epoch = progress.epoch
        self._on_deadline(progress.deadline)
        if progress.unreadable:
            log.error(
                "%d entries of the journal are no valid events for this program: they are not"
                " learned",
                progress.unreadable,
            )

    def _take_snapshot(self, stopping: threading.Event, beat: Beat) -> None:
        """Take a snapshot between batches if one is due."""
        if self._due or self.position - self._saved >= self._snapshot_entries:
            saved = self._ask(Save(), Saved, stopping, beat)
            self._on_snapshot(Snapshot(self.position, self.epoch, saved.state))
            self._saved = self.position
            self._due = False

    def _ask(
        self, question: Question, kind: type[Kind], stopping: threading.Event, beat: Beat
    ) -> Kind:
        """Send a question, handle its new versions, return the last answer. Raises `LearnerEnded`.

        It beats while the learner moves from entry to entry.
        """
        self._busy = True
        self._process.send(question)
        stopping_since = None
        while True:
            answer = self._process.receive(_TICK_SECONDS)

            # Versions come before the last answer.
            if isinstance(answer, NewVersion):
                self._hand_over_version(answer)
            elif isinstance(answer, VersionMismatch):
                self._begin_epoch(answer.version)
            elif isinstance(answer, kind):
                self._busy = False
                return answer

            if answer is not None or self._process.has_progressed():
                beat()

            # When stopping, let the learner finish its entry, or end it.
            if stopping.is_set():
                stopping_since = stopping_since or time.monotonic()
                self._process.hurry()
                if time.monotonic() - stopping_since > FINISH_SECONDS:
                    self._process.kill()

    def _hand_over_version(self, made: NewVersion) -> None:
        """Hand a new version over."""
        self._due = True
        topology = codec.read(Topology, made.packed, pack=True)
        self._on_version(Version(topology, made.content, made.packed, made.delta))

    def _begin_epoch(self, version: int) -> None:
        """Begin an epoch, as a stored version was not reproduced."""
        self.epoch = self._new_epoch()
        log.warning(
            "version %d was not reproduced (another build or processor?); epoch %s begins",
            version,
            self.epoch,
        )
        self._process.send(NewEpoch(self.epoch))
