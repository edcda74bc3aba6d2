"""Feed the journal's entries to the learner, and take its versions.

They are read from the journal as they are stored, beginning behind the snapshot. The learner runs
in its own process, so that a refit delays nothing here; order, position and failures are looked
after on this side.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from itertools import islice

from msgspec.structs import replace

from camtopod.records import CatchingUp
from camtopod.serve.learner_process.messages import INPUTS_MAX, Input, LearnBatch, LearnProgress
from camtopod.serve.learner_process.process import LearnerEnded, LearnerProcess
from camtopod.serve.learner_process.recovery import Recovered, note_failure
from camtopod.serve.runtime import Beat, no_beat
from camtopod.serve.storage import Journal

log = logging.getLogger(__name__)

GATHER_SECONDS = 0.02
"""Time in which new events are gathered into one message.

A message for each event would cost more than learning it.
"""
CATCHING_UP_SECONDS = 180.0
"""Event time by which the learner may be behind the newest stored event until it is catching up.

A fit takes this long on a large site, and a camera's clock may be a minute ahead.
"""
_TICK_SECONDS = 0.2


class LearnerFeeder:
    """Feeds the learner of ``process``; nothing else may ask that process.

    on_progress: called with the learner's progress after each step, on the thread of `work`.
    """

    def __init__(
        self,
        recovery: Recovered,
        process: LearnerProcess,
        journal: Journal,
        on_progress: Callable[[LearnProgress], None],
    ) -> None:
        self.position = recovery.position
        """Number of the last entry that is learned."""
        self.progress = recovery.progress
        """The learner's progress, as of its last step."""
        self._process = process
        self._journal = journal
        self._on_progress = on_progress
        self._replay_until = len(journal)
        self._up_to_date_at = self.position
        self._wakeup = threading.Event()
        self.damage_count = 0
        """Number of damaged journal entries that were left out."""

    def note_stored(self) -> None:
        """Entries have just been stored, to be learned soon. Any thread."""
        self._wakeup.set()

    @property
    def waiting(self) -> int:
        """Number of entries stored and not learned yet."""
        return max(0, len(self._journal) - self.position) + self._held

    @property
    def _held(self) -> int:
        """Number of events that the learner holds while it pauses behind a version."""
        return self.progress.statistics.held if self.progress.is_paused else 0

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
        progress, backlog = self.progress, self.waiting
        learned_t = progress.deadline if progress.is_paused else progress.statistics.watermark
        seconds = 0.0 if learned_t is None else newest - learned_t  # none before its first events
        position = self.position - self._held
        if not backlog or seconds < CATCHING_UP_SECONDS:
            self._up_to_date_at = position
            return None
        self._up_to_date_at = min(self._up_to_date_at, position)
        count = position - self._up_to_date_at
        return CatchingUp(seconds, count / (count + backlog))

    def work(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Feed the learner until ``stopping``; entries not learned by then are in the journal.

        Raises `LearnerEnded`.
        """
        try:
            self._learn([], stopping, beat)
            while not stopping.is_set():
                if self._wakeup.wait(_TICK_SECONDS):
                    stopping.wait(GATHER_SECONDS)
                self._wakeup.clear()
                self._process.check()
                self._learn_stored(stopping, beat)
                beat()
        except LearnerEnded as death:
            if stopping.is_set():
                return

            # Note the entry at which the learner failed, for the next start.
            note_failure(self._journal, death.at)
            raise

    def _learn_stored(self, stopping: threading.Event, beat: Beat) -> None:
        """Learn what the journal has by now, in batches."""
        before = self.damage_count
        while self.waiting and not stopping.is_set():
            last = len(self._journal)
            entries = list(islice(self._journal.entries(after=self.position), INPUTS_MAX))
            if not entries and not self.progress.is_paused:
                self.position = last  # they are no longer kept
                break
            if entries:
                self.position = entries[0][0] - 1
            inputs = [
                ("skipped", b"") if entry is None else (entry.kind, entry.raw)
                for _, entry in entries
            ]
            count = self._learn(inputs, stopping, beat)
            self.damage_count += sum(entry is None for _, entry in entries[:count])
        if self.damage_count > before:
            log.error(
                "%d damaged entries of the journal are not learned; they are still in the file",
                self.damage_count,
            )

    def _learn(self, inputs: list[Input], stopping: threading.Event, beat: Beat) -> int:
        """Have the learner learn; return the number of entries learned, which may be less.

        It beats while the learner moves from entry to entry.
        """
        self._process.send(LearnBatch(self.position, inputs))
        while (progress := self._process.receive(_TICK_SECONDS)) is None:
            if stopping.is_set():
                return 0
            if self._process.has_progressed():
                beat()

        # Note the progress, and pass on what has to be stored.
        assert isinstance(progress, LearnProgress)
        count = progress.position - self.position
        self.position = progress.position
        self.progress = replace(progress, versions=[], state=None)  # these are large
        if progress.unreadable:
            log.error(
                "%d entries of the journal are no valid events for this program: they are not"
                " learned",
                progress.unreadable,
            )
        self._on_progress(progress)
        return count
