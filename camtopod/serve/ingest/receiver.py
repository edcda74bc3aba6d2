"""From bytes on the bus to events in the journal, in order, once each; and the acks for them.

What comes is put in order and shown to the live predictions by the thread that has heard it, so
that it waits for no other; more than is dealt with at once waits in the bounded inbox, and what is
due without a message is for another thread. Only one of the two is at it at a time. A third owns
the journal: it commits what is ready, so many at a time as have come meanwhile, then hands it on to
the learner, in the same order, and acknowledges it.
"""

from __future__ import annotations

import collections
import logging
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from camtopod import codec
from camtopod.config import Limits
from camtopod.event_time import MICROSECONDS
from camtopod.event_time import EventTime as LearnedTime
from camtopod.records import CAMERA_CHARACTERS_MAX, Event
from camtopod.serve.bus import Bus, Ear, Heard
from camtopod.serve.ingest.acks import Acks
from camtopod.serve.ingest.backlog import Merge
from camtopod.serve.ingest.camera_registry import Cameras, Received
from camtopod.serve.ingest.duplicates import Duplicates
from camtopod.serve.ingest.idle_time import EventTime
from camtopod.serve.ingest.inbox import Inbox, Message
from camtopod.serve.ingest.sequencing import Streams
from camtopod.serve.ingest.store_queue import Handover
from camtopod.serve.outbox import SpoolBatch
from camtopod.serve.runtime import Beat, Clock, Rejects, everything, no_beat, steady_beside
from camtopod.serve.storage import Entry, Journal, Storing, Version, rewind

log = logging.getLogger(__name__)

_TICK_SECONDS = 0.05
_PULLED_MAX = 16
"""Answers of spools that wait at a time ..."""
_PULLED_CAMERA_MAX = 2
"""... and of one camera's, so that there is room for the others'."""
_QUANTUM_EVENTS = 100
"""Events a camera stores in its turn."""
PREDICT_SECONDS_MAX = 0.25
"""For the predictions of what is ready at a time; ..."""
BUSY_EVENTS, PREDICT_SECONDS_BUSY = 1_000, 0.002
"""... when so many wait in the inbox only so long, as predictions that are late help nobody and
events come first.
"""
_SHOWN_EVENTS = 20
"""So often it is looked whether so many wait meanwhile."""
_HUSH_SECONDS = 1.0
"""For what is heard to be put into the inbox when nothing more comes."""
BOX_BYTES_MAX = 64
"""Of what a publisher says of its box."""
BOOTS_MAX = 16
"""Incarnations of one camera's publisher that are followed; the one not heard for longest is
forgotten.
"""


class Pulled(NamedTuple):
    """The answer of a spool to a question for ``asked_from`` on."""

    batch: SpoolBatch
    asked_from: int


class Receiver:
    """Give it an ear for the events, or bytes with `on_event`, and with `on_pulled` (any thread);
    and run `work`, `store` and, with an ear, `listen` in a thread each.

    ``see`` is shown what is about to be stored, once, in journal order, and may take so many
    seconds for it; ``learn`` takes it when it is stored, and must not block; ``room()``: how many
    ``learn`` takes. ``publish``: called with each version after it is stored. ``owns``: the cameras
    whose events it is for this daemon to acknowledge; ``daemon``: its name; ``learned_time``: event
    time as the learner has it after what is stored; ``boxes``: as of `Cameras`. ``corrected``:
    called with the Unix seconds to which event time is to be taken back; returns the epoch that
    ends and the one that begins.
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
        owns: Callable[[str], bool] = everything,
        daemon: str = "",
        learned_time: LearnedTime | None = None,
        boxes: Mapping[str, str] | None = None,
        corrected: Callable[[float], tuple[str, str]] | None = None,
    ) -> None:
        self._bus, self._limits, self._clock = bus, limits, clock
        self._see, self._learn, self._learner_room, self._owns = see, learn, room, owns
        self._steady = steady or steady_beside(clock)
        self.storing = Storing(journal, clock, self._steady, publish)
        usual = journal.usual_stamp()
        self.cameras = Cameras(limits, 0.0 if usual is None else usual - clock(), boxes)
        self._learned_time, self._corrected = learned_time or LearnedTime(0.0), corrected
        self._inbox = Inbox(
            limits.inbox_events_max,
            limits.inbox_camera_events_max,
            _QUANTUM_EVENTS,
            known=lambda camera: camera in self.cameras or camera in self.with_spool,
        )
        self.ear: Ear | None = None
        self._heard_all = threading.Event()
        self._turn = threading.Lock()  # of whoever puts in order
        self._answers: collections.deque[Pulled] = collections.deque()
        self.merge = Merge(limits.held_events_max)
        stored = journal.streams()
        self._acks = Acks(bus, stored, owns, daemon, self._learned_time)
        self.duplicates = Duplicates(journal, self._steady)
        self._ready = Handover()
        self._event_time = EventTime()
        self.streams: Streams[Received] = Streams(
            stored, limits.held_events_max, limits.streams_max, BOOTS_MAX, owns
        )
        heard = dict.fromkeys(camera for camera, _ in reversed(stored))  # those heard last first
        for camera in list(heard)[: limits.cameras_max]:
            self.cameras.admit(camera, self._steady())
        self.with_spool: set[str] = set()
        """Cameras whose publisher has been seen alive, so that it has a spool."""
        self.rejects = Rejects()
        self.counts = dict.fromkeys(
            ("received", "stored", "duplicate", "future", "flood", "held_full", "refilled"), 0
        )
        self.gap = threading.Event()
        """Set when a gap appears: time to pull."""
        self._beat: Beat = no_beat

    def on_event(self, key: str, payload: bytes) -> None:
        """A publication on ``event/{camera}``. Never blocks: what does not fit is left to the
        spool.
        """
        self._inbox.put(_message(key, payload))

    def on_pulled(self, pulled: Pulled) -> bool:
        """The answer of a spool; False if there is no room for it now."""
        if self.merge.full(pulled.batch.camera):
            return False
        mine = sum(other.batch.camera == pulled.batch.camera for other in self._answers.copy())
        if len(self._answers) >= _PULLED_MAX or mine >= _PULLED_CAMERA_MAX:
            return False
        self._answers.append(pulled)
        self._inbox.poke()
        return True

    def on_alive(self, camera: str) -> None:
        """A publisher has appeared: it is told again what is stored of its camera. Any thread."""
        self.with_spool.add(camera)
        for boot in self.streams.boots(camera):
            self._acks.again((camera, boot))

    def on_deadline(self, deadline: float | None) -> None:
        """Event time at which the learner wants to be told that time went on."""
        self._event_time.deadline = deadline

    def use(self, limits: Limits) -> None:
        """Obey other limits from now on, as far as they are not the sizes of what exists. Any
        thread.
        """
        self._limits = self.cameras.limits = limits

    @property
    def crowded(self) -> str:
        """Which cameras are refused as there are too many, and what to do; "" if none is. Any
        thread.
        """
        return self.cameras.crowded(self._steady(), self.with_spool)

    @property
    def dropped(self) -> dict[str, int]:
        """Publications there was no room for, by camera ("": all that were unknown); a spool still
        has them.
        """
        return dict(self._inbox.dropped)

    def work(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Order what comes until ``stopping``, then what is in the inbox already."""
        self._ready.begin()
        try:
            while not stopping.is_set():
                self._wait()
                with self._turn:
                    self._round(self._take())
                    self._take_event_time_back()
                beat()
            if self.ear is not None:
                self.ear.close()
                self._heard_all.wait(_HUSH_SECONDS)
            with self._turn:
                self._round(self._take())
        finally:
            self._ready.end()

    def listen(self) -> None:
        """Order what the ear hears until `work` ends that; what there is no room for now is left to
        `work`.
        """
        if (ear := self.ear) is None:
            return
        try:
            while (heard := ear.take()) is not None:
                if (
                    len(heard) == 1
                    and not self._inbox
                    and self._room() > 0
                    and self._turn.acquire(blocking=False)
                ):
                    try:  # as nearly always: what comes alone has nobody to wait for
                        self._round([_message(*heard[0])], ear)
                    finally:
                        self._turn.release()
                    heard = ear.take(wait=False)
                self._note_heard(heard)
                while self._inbox and self._room() > 0 and self._turn.acquire(blocking=False):
                    try:
                        self._round(self._take(), ear)
                    finally:
                        self._turn.release()
                    self._note_heard(ear.take(wait=False))
                if self._inbox:
                    self._inbox.poke()
        finally:
            ear.close()
            self._heard_all.set()

    def _note_heard(self, heard: Sequence[Heard] | None) -> None:
        if heard:
            self._inbox.put_all([_message(*one) for one in heard])

    def store(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Store what `work` has put in order until that has ended.

        Nothing after what could not be stored: an ack says that everything up to its seq is.
        """
        self._beat = beat
        stored = True
        while stored and not self._ready.over:
            stored = self._store_waiting(stopping)
            beat()
        if stored:  # else what was stored may be gone, and it is acknowledged after the next start
            self._acks.put(math.inf, 0.0, beat)

    def _store_waiting(self, stopping: threading.Event) -> bool:
        """One transaction; False if it could not be stored."""
        limits = self._limits
        ready = self._ready.take(limits.commit_events_max, _TICK_SECONDS, limits.commit_seconds)
        if not self._store(ready, stopping):
            return False
        self._acks.put(time.monotonic(), limits.ack_seconds, self._beat)
        self.duplicates.compare(self._acks.stored)
        self.storing.forget_old()
        return True

    def _round(self, messages: list[Message | Pulled], ear: Ear | None = None) -> None:
        """From messages to what is ready to be stored. ``ear``: to be emptied now and then while
        that takes long.

        Predictions do not wait for the disk: unlike an ack they promise nothing. Each event is
        shown for them once, when its turn has come, and no duplicate or refused one comes so far.
        After a crash before the commit it comes again.
        """
        now, wall = self._steady(), self._clock()
        ready: list[Received] = []
        for message in messages:
            if isinstance(message, Pulled):
                ready += self._pulled(message, wall, now)
            else:
                ready += self._published(message, wall, now)
        ready += self.streams.give_up(time.monotonic(), self._limits.gap_seconds, self.with_spool)
        ready = self.merge.release(
            self.cameras.in_time(ready, wall, now), time.monotonic(), self._room
        )
        ready = self._without_floods(ready)
        if (advanced := self._event_time.went_on(now, self._limits.settle_seconds)) is not None:
            ready.append(
                Received(
                    Entry("advance", "", None, None, repr(advanced).encode()), advance=advanced
                )
            )
        if ready:
            self._show(ready, ear)  # before anything else
            self._ready.put(ready)
            times = [one.event.t for one in ready if one.event is not None]
            right = wall + self.cameras.clock_behind
            self._event_time.note(times, right, now, self._limits.future_seconds_max)
        self._acks.forget(self.streams.forgotten())
        if self.streams.gaps:
            self.gap.set()

    def _take_event_time_back(self) -> None:
        """If a wrong clock had taken it along: an entry in the journal, which the learner obeys in
        its turn.
        """
        watermark = self._learned_time.watermark_us
        to = self.cameras.rewind_to(
            None if watermark is None else watermark / MICROSECONDS, self._clock(), self._steady()
        )
        if to is None or self._corrected is None:
            return
        ended, begun = self._corrected(to)
        log.error(
            "event time was %.0f s ahead of this machine's clock: what lies ahead is dropped, and event time goes on "
            "from that clock, in epoch %s",
            (watermark or 0) / MICROSECONDS - to,
            begun,
        )
        entry, lesson = rewind(to, ended, begun)
        self._event_time.rewind()
        self.merge.rewind(to)
        self._ready.put([Received(entry, rewind=lesson)])

    def _show(self, ready: list[Received], ear: Ear | None) -> None:
        """For predictions, as long as there is time."""
        spent = 0.0
        for first in range(0, len(ready), _SHOWN_EVENTS):
            most, began = PREDICT_SECONDS_MAX, time.monotonic()
            if len(self._inbox) > BUSY_EVENTS:
                most = PREDICT_SECONDS_BUSY
            if spent >= most:
                self._see(ready[first:], 0.0)
                return
            self._see(ready[first : first + _SHOWN_EVENTS], most - spent)
            spent += time.monotonic() - began
            if ear is not None:
                self._note_heard(ear.take(wait=False))

    def _room(self) -> int:
        """How many events may be put in order now: another transaction's worth while one is being
        stored.
        """
        return min(2 * self._limits.commit_events_max, self._learner_room()) - self._ready.waiting

    def _wait(self) -> None:
        """Until there may be something to put in order, and room for it."""
        if self._room() <= 0:
            self._ready.wait_for_room(_TICK_SECONDS)
        elif not self._answers:
            self._inbox.wait(_TICK_SECONDS)

    def _take(self) -> list[Message | Pulled]:
        """What came in, at most a transaction's worth and no more than the learner has room for."""
        room = min(self._limits.commit_events_max, self._room())
        if room <= 0:
            return []
        messages: list[Message | Pulled] = []
        while self._answers and room > 0:
            answer = self._answers.popleft()
            messages.append(answer)
            room -= len(answer.batch.events)
        return messages + self._inbox.take(max(room, _QUANTUM_EVENTS))

    def _published(self, message: Message, wall: float, now: float) -> list[Received]:
        self.counts["received"] += 1
        camera, raw = message.camera, message.raw
        try:
            event = codec.event_from_bytes(raw)
        except codec.Rejected as error:
            self.rejects.add(error.reason, f"event/{camera}", str(error), raw)
            return []
        if event.camera != camera:
            self.rejects.add(
                "wrong-camera", f"event/{camera}", f"says camera {event.camera!r}", raw
            )
            return []
        if not self._admitted(camera, now, raw):
            return []
        return self._order(self._judge(event, raw, wall, now, fresh=True, box=message.box))

    def _pulled(self, pulled: Pulled, wall: float, now: float) -> list[Received]:
        batch = pulled.batch
        key = (batch.camera, batch.boot)
        if not self._admitted(batch.camera, now, b""):
            return []
        self._notice_loss(batch)
        ready = self.streams.begins_at(key, batch.first, time.monotonic())
        times = []
        for seq, raw in batch.events:
            received = Received(
                Entry("refused", batch.camera, batch.boot, seq, raw[: codec.EVENT_BYTES_MAX])
            )
            try:
                event = codec.event_from_bytes(raw)
                if (event.camera, event.boot, event.seq) == (batch.camera, batch.boot, seq):
                    received = self._judge(event, raw, wall, now, fresh=False)
                    times.append(event.t)
                else:
                    self.rejects.add(
                        "wrong-camera", f"spool/{batch.camera}", "says another stream", raw
                    )
            except codec.Rejected as error:
                self.rejects.add(error.reason, f"spool/{batch.camera}", str(error), raw)
            ready += self._order(received)
        self.merge.answered(batch.camera, times, batch.more, time.monotonic())
        seqs = [seq for seq, _ in batch.events]
        self.streams.answered(key, pulled.asked_from, seqs, batch.more, knows=batch.first > 0)
        if batch.first <= self._acks.stored.get(key, -1) != batch.acked:
            self._acks.again(key)  # it has what is stored here already: the ack got lost
        return ready

    def _notice_loss(self, batch: SpoolBatch) -> None:
        """Say it when a publisher has been told that more is stored than is: it is being filled in
        again.
        """
        stored = self._acks.stored.get((batch.camera, batch.boot), -1)
        missing = sum(stored < seq <= (batch.acked or 0) for seq, _ in batch.events)
        if missing and self._owns(batch.camera):
            if not self.counts["refilled"]:
                log.error(
                    "the journal has come back shorter than it was: what camera %s had stored after %d, and perhaps "
                    "others', is filled in from the spools",
                    batch.camera,
                    stored,
                )
            self.counts["refilled"] += missing

    def _admitted(self, camera: str, now: float, raw: bytes) -> bool:
        admitted = self.cameras.admit(camera, now, self.with_spool)
        if not admitted:
            self.rejects.add(
                "too-many-cameras", f"event/{camera}", "limits.cameras_max is reached", raw
            )
        return admitted

    def _judge(
        self, event: Event, raw: bytes, wall: float, now: float, fresh: bool, box: str = ""
    ) -> Received:
        if self.cameras.is_future(event, wall, now, fresh, box):
            self.counts["future"] += 1
            self.rejects.add(
                "future", f"event/{event.camera}", "t is ahead of this machine's clock", raw
            )
            return Received(Entry("future", event.camera, event.boot, event.seq, raw))
        return Received(Entry("event", event.camera, event.boot, event.seq, raw), event)

    def _order(self, received: Received) -> list[Received]:
        """What is ready now; what has no count is at once."""
        entry = received.entry
        camera, boot, seq = entry.camera, entry.boot, entry.seq
        if self.cameras.full(camera) or self.merge.full(camera):
            self.counts["held_full"] += 1
            return []
        if boot is None or seq is None:
            return [received]
        verdict, ready = self.streams.offer((camera, boot), seq, received, time.monotonic())
        if verdict == "duplicate":
            self.counts["duplicate"] += 1
            self.duplicates.note(entry)
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

    def _without_floods(self, ready: list[Received]) -> list[Received]:
        """What a camera sends beyond what a view can show is not learned; of it only the count is
        stored.
        """
        kept = []
        for received in ready:
            if received.event is not None and not self.cameras.note(received.event):
                self.counts["flood"] += 1
                entry = received.entry
                if entry.seq is None:
                    continue
                received = Received(Entry("refused", entry.camera, entry.boot, entry.seq, b""))
            kept.append(received)
        return kept

    def _store(self, ready: list[Received], stopping: threading.Event) -> bool:
        """Into the journal, then on to the learner; False if it could not be stored."""
        if not self.storing.store([received.entry for received in ready], stopping, self._beat):
            return False
        if ready:
            self._acks.note(ready)
            self.counts["stored"] += sum(received.event is not None for received in ready)
            self._learn(ready)
        self._ready.done()
        return True


def _message(key: str, payload: bytes, attachment: bytes = b"") -> Message:
    name = key.removeprefix("event/")[
        : CAMERA_CHARACTERS_MAX + 1
    ]  # so much says that it is too long
    return Message(
        name,
        payload[: codec.EVENT_BYTES_MAX + 1],
        attachment[:BOX_BYTES_MAX].decode("ascii", "replace"),
    )
