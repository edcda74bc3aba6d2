"""The path of an event from the bus into the journal, and the three threads that move it.

The path. `Receiver._round` is the place where all of it can be read. Messages are publications and
the answers of spools, which the `Puller` asks for missing events. Message by message, events are

1. decoded and admitted: malformed messages, and cameras beyond the limit, are rejected
   (`admission`);
2. put in order within their stream: duplicates end here, and events behind a gap wait until it is
   filled from the spool or given up (`sequencing`).

Events that are ready then pass a list of stages, all events of a round together:

3. events behind gaps that cannot be filled any more are added;
4. events ahead of the clocks are held back until their time has come (`camera_registry`);
5. while spools deliver backlogs, events are merged by time (`backlog`);
6. events of forgotten cameras become entries that are not learned, those of renamed cameras get
   the new name (`names`);
7. events beyond the most that one view can produce become entries that are not learned;
8. an entry that advances event time is added when no events come (`idle_time`);
9. predictions are made;
10. the entries are put into the queue to be stored (`store_queue`).

`Receiver.store` takes the entries from the queue; many together, they are

11. committed to the journal in one transaction;
12. noted as stored (`Acks.note_stored`);
13. handed to the learner, in the journal's order;
14. acknowledged (`Acks.publish`), at most once in ``ack_seconds``.

An operator's command (`Receiver.administer`) enters the queue between two rounds.

Guarantees. An acknowledgement says that everything up to its seq is stored. An event for which
there is no room is dropped before its stream has counted it. So its stream has a gap there, and the
event is pulled from the spool later; it is lost only if it has no number (boot, seq) or its
publisher has no spool. Nothing waits without a limit. Predictions do not wait for the disk, as they
promise nothing: after a crash before the commit, the event comes again and is predicted from again.

The threads. `Receiver.listen` reads the subscription and moves what it receives along the path
itself, as waking another thread would delay predictions. Messages for which there is no room yet,
or which come while another thread is ordering events, wait in a bounded queue (`inbox`).
`Receiver.work` takes those, the answers of spools, and events that become due without a message.
Only one of the two orders events at a time, the one that has the turn. `Receiver.store` owns the
journal, so a slow disk delays neither.
"""

from __future__ import annotations

import collections
import contextlib
import logging
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence

import msgspec

from camtopod.admin import Command, Reset
from camtopod.config import Limits
from camtopod.event_time import MICROSECONDS, EventTime as LearnedTime
from camtopod.records import Topology
from camtopod.serve.bus import Bus, Heard, Subscription
from camtopod.serve.ingest.acks import Acks
from camtopod.serve.ingest.admission import SpoolAnswer, read_message
from camtopod.serve.ingest.camera_registry import CameraRegistry, Received
from camtopod.serve.ingest.duplicates import DuplicateChecker
from camtopod.serve.ingest.inbox import Inbox, Message
from camtopod.serve.ingest.names import CommandRefused, Names, known_site, read_names
from camtopod.serve.ingest.stages import Round, Stages
from camtopod.serve.ingest.store_queue import StoreQueue
from camtopod.serve.runtime import Beat, Clock, no_beat, steady_clock_for
from camtopod.serve.storage import NAMES_KEY, Journal, JournalWriter, Version, rewind

log = logging.getLogger(__name__)

_TICK_SECONDS = 0.05
"""Longest wait of `Receiver.work` and `Receiver.store` for something to do."""
_ANSWERS_MAX = 16
"""Most answers of spools that wait at a time."""
_CAMERA_ANSWERS_MAX = 2
"""Most answers of one camera's spool that wait, so that there is room for others."""
_QUANTUM_EVENTS = 100
"""Number of events that a camera's queue in the inbox gives in its turn."""
_PREDICTED_EVENTS = 20
"""Number of events after whose predictions the length of the inbox is checked again."""
PREDICT_SECONDS_MAX = 0.25
"""Longest time for the predictions of one round."""
BUSY_EVENTS = 1_000
"""The inbox is busy if more events than this wait in it."""
PREDICT_SECONDS_BUSY = 0.002
"""Longest time for the predictions of one round while the inbox is busy.

Late predictions help nobody, and storing events comes first.
"""
STORED_SECONDS_MAX = 20.0
"""Longest wait until an operator's command is stored."""
_CLOSING_SECONDS = 1.0
"""Longest wait, at the end, until `Receiver.listen` has read what the subscription still has."""


class Receiver:
    """Takes events from the bus into the journal.

    Set its ``subscription``, or give it messages with `on_event`; give it spools' answers with
    `on_answer`. Run `work`, `store` and, if there is a subscription, `listen`, each in a thread.

    learn: takes stored entries, in journal order. It must not block.
    room: returns how many entries ``learn`` takes now.
    publish: called with each version after it is stored.
    see: predicts from entries about to be stored, in journal order, each once, within the given
        number of seconds.
    steady: a clock that never steps.
    daemon: name of this daemon.
    learned_time: event time as the learner has it after the entries stored so far.
    boxes: certificates of cameras; see `CameraRegistry`.
    corrected: begins a new epoch, as event time is taken back to the given Unix seconds; returns
        the epoch that ends and the one that begins.
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
        see: Callable[[list[Received], float], None],
        steady: Clock | None = None,
        daemon: str = "",
        learned_time: LearnedTime | None = None,
        boxes: Mapping[str, str] | None = None,
        corrected: Callable[[float], tuple[str, str]] | None = None,
    ) -> None:
        # Settings, clocks and callbacks.
        self._limits, self._clock, self._steady = limits, clock, steady or steady_clock_for(clock)
        self._see, self._learn, self._learner_room = see, learn, room
        self._learned_time, self._corrected = learned_time or LearnedTime(0.0), corrected

        # Collaborators along the path, up to the journal.
        stored, usual = journal.streams(), journal.median_stored_time()
        self.cameras = CameraRegistry(limits, 0.0 if usual is None else usual - clock(), boxes)
        self.duplicates = DuplicateChecker(journal, self._steady)
        self._acks = Acks(bus, stored, daemon, self._learned_time)
        self.names = Names(read_names(journal.meta(NAMES_KEY)), clock)
        self._stages = Stages(
            self.cameras, self.duplicates, self._acks, limits, self._room, self.names
        )
        self._queue = StoreQueue()
        self.storing = JournalWriter(journal, clock, self._steady, publish)
        self._beat: Beat = no_beat

        # Parts of the stages that the status and the puller read.
        self.rejects, self.counts = self._stages.rejects, self._stages.counts
        self.streams, self.merge = self._stages.streams, self._stages.merge
        self.with_spool = self._stages.with_spool

        # What waits to be put in order, and whose turn it is.
        self.subscription: Subscription | None = None
        """The subscription that `listen` reads; None if `on_event` is called instead."""
        self._inbox = Inbox(
            limits.inbox_events_max,
            limits.inbox_camera_events_max,
            _QUANTUM_EVENTS,
            known=lambda camera: camera in self.cameras or camera in self.with_spool,
        )
        self._answers: collections.deque[SpoolAnswer] = collections.deque()
        self._turn = threading.Lock()  # held while ordering events
        self._listened = threading.Event()  # set when `listen` has ended
        self.gap = threading.Event()
        """Set when a gap appears: time to pull."""

        # Admit the cameras that the journal has, those received from last first.
        known = dict.fromkeys(camera for camera, _ in reversed(stored))
        for camera in list(known)[: limits.cameras_max]:
            self.cameras.register(camera, self._steady())

    def on_event(self, key: str, payload: bytes) -> None:
        """Take a publication on ``event/{camera}``. Any thread; never blocks.

        If there is no room for it, it is left to the spool.
        """
        self._inbox.put(read_message(key, payload))

    def on_answer(self, answer: SpoolAnswer) -> bool:
        """Take the answer of a spool; return False if there is no room for it now. Any thread."""
        camera = answer.batch.camera
        if self.merge.is_full(camera):
            return False
        of_camera = sum(other.batch.camera == camera for other in self._answers.copy())
        if len(self._answers) >= _ANSWERS_MAX or of_camera >= _CAMERA_ANSWERS_MAX:
            return False
        self._answers.append(answer)
        self._inbox.wake()
        return True

    def on_alive(self, camera: str) -> None:
        """Note that a camera's publisher has appeared, and repeat its acks. Any thread."""
        self.with_spool.add(camera)
        for boot in self.streams.boots(camera):
            self._acks.repeat((camera, boot))

    def on_deadline(self, deadline: float | None) -> None:
        """Set the event time at which the learner wants to know that time has passed."""
        self._stages.idle_time.deadline = deadline

    def administer(self, command: Command, topology: Topology | None) -> str:
        """Execute an operator's command; return its effect once it is stored. Any thread.

        topology: the newest version.

        Raises `CommandRefused` and `sqlite3.Error`.
        """
        with self._turn:
            # Begin the epoch of a reset.
            if isinstance(command, Reset) and self._corrected is not None:
                t = self._clock() + self.cameras.clock_behind
                command = Reset(t, *self._corrected(t))

            # Carry it out for the events to come, and store it in its place among them.
            heard = (camera for camera, _ in self._acks.stored.copy())
            site = known_site(topology, self.cameras.status(), heard, self.names.state.since)
            entry, said = self.names.carry_out(command, site)
            self._stages.administer(command, self.names.state)
            stored = threading.Event()
            self._queue.put([msgspec.structs.replace(entry, stored=stored)])

        if not stored.wait(STORED_SECONDS_MAX):
            raise CommandRefused(
                f"it is not stored after {STORED_SECONDS_MAX:g} s, as the disk does not answer; the"
                " status of the daemon will show whether it was carried out"
            )
        log.warning("%s", said)
        return said

    def set_limits(self, limits: Limits) -> None:
        """Use other limits from now on, except for sizes of what exists already. Any thread."""
        self._limits = self.cameras.limits = limits

    @property
    def refused_reason(self) -> str:
        """Which cameras are refused, as there are too many, and what to do; else "". Any thread."""
        return self.cameras.refused_reason(self._steady(), self.with_spool)

    @property
    def dropped(self) -> dict[str, int]:
        """Number of publications dropped as the inbox was full, by camera; a spool still has them.

        All unknown cameras count as "".
        """
        return dict(self._inbox.dropped)

    # --- threads ----------------------------------------------------------------------------------

    def listen(self) -> None:
        """Move what the subscription receives along the path, until `work` closes it.

        It never waits for room or for the turn, as all other messages on the bus would wait, too:
        it leaves its messages in the inbox to `work`.
        """
        if (subscription := self.subscription) is None:
            return
        try:
            while (heard := subscription.receive()) is not None:
                # The usual case: a message comes alone, and none waits before it. With the turn,
                # it is ordered at once, and then ``heard`` are the messages that have come
                # meanwhile. Without the turn, ``heard`` is still this message. Either goes into the
                # inbox.
                if len(heard) == 1 and not self._inbox:
                    with self._try_turn() as has_turn:
                        if has_turn:
                            self._round([read_message(*heard[0])], subscription)
                    if has_turn:
                        heard = subscription.receive(wait=False)
                self._note_heard(heard)

                # Order the messages that wait in the inbox until none is left, there is no room, or
                # another thread has the turn. The subscription is read after the turn has been
                # given back.
                has_turn = True
                while has_turn and self._inbox:
                    with self._try_turn() as has_turn:
                        if has_turn:
                            self._round(self._take_messages(), subscription)
                    if has_turn:
                        self._note_heard(subscription.receive(wait=False))

                # Leave the rest to `work`.
                if self._inbox:
                    self._inbox.wake()
        finally:
            subscription.close()
            self._listened.set()

    def work(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Move messages along the path until ``stopping``, and then those still in the inbox."""
        self._queue.open()
        try:
            while not stopping.is_set():
                self._wait()
                with self._turn:
                    self._round(self._take_messages())
                    self._take_event_time_back()
                beat()

            # At the end, order what was received before.
            if self.subscription is not None:
                self.subscription.close()
                self._listened.wait(_CLOSING_SECONDS)
            with self._turn:
                self._round(self._take_messages())
        finally:
            self._queue.close()

    def store(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Store what is in the queue until `work` has ended.

        Nothing is stored after entries that could not be stored, as an ack says that everything up
        to its seq is stored.
        """
        self._beat = beat
        stored = True
        while stored and not self._queue.is_finished:
            stored = self._store_waiting(stopping)
            beat()

        # After a failure even stored entries may be gone; the next start acknowledges the rest.
        if stored:
            self._acks.publish(math.inf, 0.0, beat)

    @contextlib.contextmanager
    def _try_turn(self) -> Iterator[bool]:
        """Hold the turn during the block if there is room and it is free; yield True then."""
        has_turn = self._room() > 0 and self._turn.acquire(blocking=False)
        try:
            yield has_turn
        finally:
            if has_turn:
                self._turn.release()

    # --- messages ---------------------------------------------------------------------------------

    def _room(self) -> int:
        """Return how many events may be put in order now.

        Two transactions' worth may wait: the one that is being stored, and the next.
        """
        return min(2 * self._limits.commit_events_max, self._learner_room()) - self._queue.waiting

    def _wait(self) -> None:
        """Wait until there may be something to put in order, and room for it."""
        if self._room() <= 0:
            self._queue.wait_for_room(_TICK_SECONDS)
        elif not self._answers:
            self._inbox.wait(_TICK_SECONDS)

    def _take_messages(self) -> list[Message | SpoolAnswer]:
        """Return waiting messages, about one transaction's worth; none if there is no room.

        Answers come first. The inbox may give up to `_QUANTUM_EVENTS` messages even if the answers
        have used up the room, so that new events do not wait for backlogs.
        """
        room = min(self._limits.commit_events_max, self._room())
        if room <= 0:
            return []
        messages: list[Message | SpoolAnswer] = []
        while self._answers and room > 0:
            answer = self._answers.popleft()
            messages.append(answer)
            room -= len(answer.batch.events)
        return messages + self._inbox.take(max(room, _QUANTUM_EVENTS))

    def _note_heard(self, heard: Sequence[Heard] | None) -> None:
        """Put messages of the subscription into the inbox."""
        if heard:
            self._inbox.put_all([read_message(*one) for one in heard])

    # --- the path ---------------------------------------------------------------------------------

    def _round(
        self, messages: Sequence[Message | SpoolAnswer], subscription: Subscription | None = None
    ) -> None:
        """Move messages along the path, up to the queue to be stored.

        Admission and sequencing are not in the list of stages, as they go message by message: an
        admitted camera may replace that of the message before, whose clock must have been judged
        by then; and an answer also says which events its spool lacks, which must be noted before
        the next message is put in order.

        subscription: read into the inbox now and then while predictions take long; None to leave
            it alone.
        """
        # Steps 1 and 2, message by message.
        stages = self._stages
        this_round = Round(
            now=self._steady(), wall=self._clock(), limits=self._limits, subscription=subscription
        )
        ready: list[Received] = []
        for message in messages:
            ready += stages.enter(message, this_round)

        # Steps 3 to 10, all events together: the list of stages.
        for stage in (
            stages.give_up_gaps,
            stages.hold_back,
            stages.merge_backlogs,
            stages.apply_names,
            stages.limit_floods,
            stages.advance_idle_time,
            self._predict,
            self._hand_over,
        ):
            ready = stage(ready, this_round)

        # Forget the acks of streams that are no longer followed; let the puller fill gaps.
        self._acks.forget(stages.streams.take_forgotten())
        if stages.streams.gaps:
            self.gap.set()

    def _predict(self, ready: list[Received], this_round: Round) -> list[Received]:
        """Predict from the entries before they are stored, as long as there is time.

        Each event comes here once: duplicates and rejected events have ended before.
        """
        spent = 0.0
        for first in range(0, len(ready), _PREDICTED_EVENTS):
            # When the time is over, the rest is passed with 0 s: `see` skips it, but counts the
            # exits that get no prediction.
            busy = len(self._inbox) > BUSY_EVENTS
            most, began = PREDICT_SECONDS_BUSY if busy else PREDICT_SECONDS_MAX, time.monotonic()
            if spent >= most:
                self._see(ready[first:], 0.0)
                break

            # Predict from the next few, and read what was received meanwhile.
            self._see(ready[first : first + _PREDICTED_EVENTS], most - spent)
            spent += time.monotonic() - began
            if this_round.subscription is not None:
                self._note_heard(this_round.subscription.receive(wait=False))
        return ready

    def _hand_over(self, ready: list[Received], this_round: Round) -> list[Received]:
        """Put the entries into the queue to be stored, and note their event times."""
        if ready:
            self._queue.put(ready)
            times = [one.event.t for one in ready if one.event is not None]
            right = this_round.wall + self.cameras.clock_behind
            self._stages.idle_time.note(
                times, right, this_round.now, this_round.limits.future_seconds_max
            )
        return ready

    # --- event time --------------------------------------------------------------------------

    def _take_event_time_back(self) -> None:
        """Take event time back if a wrong clock has advanced it.

        The learner does so when it comes to the entry for it, in the journal's order.
        """
        watermark = self._learned_time.watermark_us
        to = self.cameras.rewind_to(
            None if watermark is None else watermark / MICROSECONDS, self._clock(), self._steady()
        )
        if to is None or self._corrected is None:
            return
        ended, begun = self._corrected(to)
        log.error(
            "event time was %.0f s ahead of this machine's clock: the events ahead are dropped, and"
            " event time continues from that clock, in epoch %s",
            (watermark or 0) / MICROSECONDS - to,
            begun,
        )
        entry, for_learner = rewind(to, ended, begun)
        self._stages.idle_time.rewind()
        self._stages.merge.rewind(to)
        self._queue.put([Received(entry, rewind=for_learner)])

    # --- the journal ------------------------------------------------------------------------------

    def _store_waiting(self, stopping: threading.Event) -> bool:
        """Store one transaction's worth and publish acks; return False if that failed for good."""
        limits = self._limits
        ready = self._queue.take(limits.commit_events_max, _TICK_SECONDS, limits.commit_seconds)
        if not self._store(ready, stopping):
            return False
        self._acks.publish(time.monotonic(), limits.ack_seconds, self._beat)
        self.duplicates.compare(self._acks.stored)
        self.storing.prune()
        return True

    def _store(self, ready: list[Received], stopping: threading.Event) -> bool:
        """Store entries, then hand them to the learner; return False if that failed for good."""
        names = [received.names for received in ready if received.names is not None]
        meta = {NAMES_KEY: names[-1]} if names else None
        entries = [received.entry for received in ready]
        if not self.storing.store(entries, stopping, self._beat, meta):
            return False
        if ready:
            self._acks.note_stored(ready)
            self.counts["stored"] += sum(received.event is not None for received in ready)
            self._learn(ready)
            for received in ready:
                if received.stored is not None:
                    received.stored.set()
        self._queue.done()
        return True
