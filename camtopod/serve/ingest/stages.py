"""The stages that events pass from the bus to the queue to be stored; no threads.

`Receiver._round` walks them; the head of its module lists them. A stage takes the entries that are
ready and returns those that go on. Entries that wait in a stage are kept by its collaborator:
`Streams`, `CameraRegistry` or `BacklogMerger`.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import NamedTuple

from camtopod.admin import Command, Forget, Rename, Reset
from camtopod.config import Limits
from camtopod.serve.bus import Subscription
from camtopod.serve.ingest.acks import Acks
from camtopod.serve.ingest.admission import Admission, SpoolAnswer
from camtopod.serve.ingest.backlog import BacklogMerger
from camtopod.serve.ingest.camera_registry import CameraRegistry, Received
from camtopod.serve.ingest.duplicates import DuplicateChecker
from camtopod.serve.ingest.idle_time import IdleEventTime
from camtopod.serve.ingest.inbox import Message
from camtopod.serve.ingest.names import Names, NamesState
from camtopod.serve.ingest.sequencing import Streams
from camtopod.serve.outbox import SpoolBatch
from camtopod.serve.runtime import Rejects
from camtopod.serve.storage import Entry

log = logging.getLogger(__name__)

BOOTS_MAX = 16
"""Most boots of one camera's publisher that are followed; that received from last goes last."""


class Round(NamedTuple):
    """What all stages of one round share.

    wall: this machine's time, in Unix seconds.
    now (seconds): time of the steady clock.
    limits: those in force.
    subscription: the subscription to be read while the round takes long; None if there is none.
    """

    wall: float
    now: float
    limits: Limits
    subscription: Subscription | None = None


class Stages:
    """The stages and their collaborators; called by one thread at a time.

    cameras, duplicates, acks: collaborators that others use, too.
    room: returns how many entries may be put in order now.
    names: forgotten and renamed cameras.
    """

    def __init__(
        self,
        cameras: CameraRegistry,
        duplicates: DuplicateChecker,
        acks: Acks,
        limits: Limits,
        room: Callable[[], int],
        names: Names,
    ) -> None:
        self._names = names
        self._cameras, self._duplicates, self._acks = cameras, duplicates, acks
        self._room = room
        self.rejects = Rejects()
        self.counts = dict.fromkeys(
            ("received", "stored", "duplicate", "future", "flood", "held_full", "refilled"), 0
        )
        """Counters of the status; "stored" is counted by the thread that stores."""
        self.with_spool: set[str] = set()
        """Cameras whose publisher has been seen alive, so that it has a spool."""
        self._admission = Admission(cameras, self.with_spool, self.rejects, self.counts)
        self.streams: Streams[Received] = Streams(
            acks.stored, limits.held_events_max, limits.streams_max, BOOTS_MAX
        )
        self.merge = BacklogMerger(limits.held_events_max)
        self.idle_time = IdleEventTime()

    def enter(self, message: Message | SpoolAnswer, this_round: Round) -> list[Received]:
        """Decode, admit and sequence the events of a message; return those that are ready by it."""
        if isinstance(message, SpoolAnswer):
            return self._enter_answer(message, this_round)
        received = self._admission.admit(message, this_round.wall, this_round.now)
        return [] if received is None else self._sequence(received)

    def give_up_gaps(self, ready: list[Received], this_round: Round) -> list[Received]:
        """Add the events behind gaps that cannot be filled any more."""
        patience = this_round.limits.gap_seconds
        return ready + self.streams.give_up_gaps(time.monotonic(), patience, self.with_spool)

    def hold_back(self, ready: list[Received], this_round: Round) -> list[Received]:
        """Return the events whose time has come, of these and of those held back before."""
        return self._cameras.release_due(ready, this_round.wall, this_round.now)

    def merge_backlogs(self, ready: list[Received], this_round: Round) -> list[Received]:
        """Return the events before which no others are expected from spools with a backlog."""
        return self.merge.release(ready, time.monotonic(), self._room)

    def administer(self, command: Command, names: NamesState) -> None:
        """Apply an operator's command to the cameras' counters.

        names: the names after the command.
        """
        match command:
            case Forget():
                for name in names.forgotten:
                    self._cameras.forget(name)
            case Rename(old, new):
                self._cameras.rename(old, new)
            case Reset():
                self._cameras.forget_all()
                self.idle_time.rewind()
            case _:
                pass

    def apply_names(self, ready: list[Received], this_round: Round) -> list[Received]:
        """Refuse the events of forgotten cameras, and rename those of renamed ones."""
        return [entry for received in ready for entry in self._names.apply(received)]

    def limit_floods(self, ready: list[Received], this_round: Round) -> list[Received]:
        """Replace what a camera sends beyond what a view can show; only its number is stored."""
        kept = []
        for received in ready:
            if received.event is not None and not self._cameras.count_event(received.event):
                self.counts["flood"] += 1
                entry = received.entry
                if entry.seq is None:
                    continue
                received = Received(Entry("refused", entry.camera, entry.boot, entry.seq, b""))
            kept.append(received)
        return kept

    def advance_idle_time(self, ready: list[Received], this_round: Round) -> list[Received]:
        """Add an entry that advances event time, if no events come and the learner waits for it."""
        advanced = self.idle_time.advance_to(this_round.now, this_round.limits.settle_seconds)
        if advanced is None:
            return ready
        entry = Entry("advance", "", None, None, repr(advanced).encode())
        return [*ready, Received(entry, advance=advanced)]

    def _enter_answer(self, answer: SpoolAnswer, this_round: Round) -> list[Received]:
        """Return what becomes ready by a spool's answer, and note what it says of its stream."""
        opened = self._admission.open(answer, this_round.wall, this_round.now)
        if opened is None:
            return []

        # Give up events below the answer's first, which the spool has no more; then take its own.
        batch = answer.batch
        key = (batch.camera, batch.boot)
        self._notice_loss(batch)
        ready = self.streams.skip_before(key, batch.first, time.monotonic())
        for received in opened.entries:
            ready += self._sequence(received)

        # Note how far the backlog has come, and which events of a gap the spool lacks.
        self.merge.note_answer(batch.camera, opened.times, batch.more, time.monotonic())
        seqs = [seq for seq, _ in batch.events]
        self.streams.note_answer(key, answer.asked_from, seqs, batch.more, knows=batch.first > 0)

        # Repeat the ack if the spool still has events that are stored, as it was lost.
        if batch.first <= self._acks.stored.get(key, -1) != batch.acked:
            self._acks.repeat(key)
        return ready

    def _sequence(self, received: Received) -> list[Received]:
        """Return the entries that are ready by this one, in order of seq."""
        # Drop it if its camera has too many events waiting in a later stage.
        entry = received.entry
        camera, boot, seq = entry.camera, entry.boot, entry.seq
        if self._cameras.is_full(camera) or self.merge.is_full(camera):
            self.counts["held_full"] += 1
            return []
        if boot is None or seq is None:
            return [received]  # without a number, it is ready at once

        # Offer it to its stream, and count it if it is not taken.
        verdict, ready = self.streams.add((camera, boot), seq, received, time.monotonic())
        if verdict == "duplicate":
            self.counts["duplicate"] += 1
            self._duplicates.note(entry)
            self._acks.duplicate((camera, boot))
        elif verdict == "dropped":
            self.counts["held_full"] += 1
        elif verdict == "refused":
            self.rejects.add(
                "too-many-streams", f"event/{camera}", "limits.streams_max is reached", entry.raw
            )
        elif verdict == "jump":
            self.rejects.add(
                "seq-jump", f"event/{camera}", f"seq {seq} is too far ahead", entry.raw
            )
        return ready

    def _notice_loss(self, batch: SpoolBatch) -> None:
        """Count and report events that were acknowledged once, but are not in the journal."""
        stored = self._acks.stored.get((batch.camera, batch.boot), -1)
        missing = sum(stored < seq <= (batch.acked or 0) for seq, _ in batch.events)
        if missing:
            if not self.counts["refilled"]:
                log.error(
                    "the journal lacks events that were stored: those of camera %s after number %d,"
                    " and perhaps other cameras'; they are pulled from the spools and stored again",
                    batch.camera,
                    stored,
                )
            self.counts["refilled"] += missing
