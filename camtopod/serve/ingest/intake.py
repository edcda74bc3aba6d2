"""The path of an event from the bus into the journal: hear, decode, store, answer.

Events come in requests of grabbers' spools (`camtopod.serve.requests`), one at a time for each
camera, and as publications: by grabbers, of what their spools deliver as well, and by other
programs. `Intake.step` moves events as far as the store queue, and `Intake.store_waiting` from
there into the journal:

1. an event is heard, once, for predictions: where it comes first, by a publication or by its
   delivery. That waits for nothing but what was heard before, and counts nothing;
2. a request is admitted, and its events are decoded; an invalid event is stored under its number,
   so that the spool can drop it, and is not learned;
3. forgotten and renamed cameras are looked after (`names`), floods are cut (`cameras`), the learner
   is told which backlogs to wait for (`backlogs`), and event time follows the clock when no events
   come (`event_clock`);
4. the events are committed to the journal, many in one transaction, and handed to the learner;
5. each request whose events are all stored is answered (`answers`).

Guarantees. An answer names the highest number that is on disk. A camera's events are taken, stored
and learned in the order of their numbers, so everything below is on disk, too. No camera waits for
another.
Every request is answered: at once if nothing is taken, with the reason or with where to begin; with
``held`` if its events are not stored after a minute. The events in memory are bounded by
`EVENTS_MAX`, and requests by one a camera (`inbox`; `camtopod.keys.rules` bounds their size).
"""

from __future__ import annotations

import logging
import threading
from collections import Counter, deque
from collections.abc import Callable, Sequence, Set

from camtopod import codec
from camtopod.admin import Rewind
from camtopod.config import Limits
from camtopod.learn.settings import TopologySettings
from camtopod.records import Event
from camtopod.serve.ingest.answers import PendingRequests
from camtopod.serve.ingest.backlogs import Backlogs
from camtopod.serve.ingest.cameras import CameraIntake, Cameras, Pending
from camtopod.serve.ingest.event_clock import EventClock
from camtopod.serve.ingest.inbox import Inbox, Reply
from camtopod.serve.ingest.names import Names, missing_names
from camtopod.serve.ingest.numbers import Numbers
from camtopod.serve.ingest.received import (
    Received,
    command_received,
    event_of,
    request_of,
    spooled_event,
)
from camtopod.serve.ingest.store_queue import StoreQueue
from camtopod.serve.requests import Hello
from camtopod.serve.runtime import Beat, Clock, Rejects, no_beat
from camtopod.serve.storage import Entry, JournalWriter, highest_numbers
from camtopod.words import present_of

log = logging.getLogger(__name__)

EVENTS_MAX = 50_000
"""Most events in memory, received and not yet stored; further requests are answered ``busy``."""
COMMIT_EVENTS_MAX = 5_000
"""Maximum number of events in one transaction of the journal."""
TAKEN_AT_ONCE_MAX = 1_000
"""Number of events after which no further request is taken before the next step."""
HEARD_AT_ONCE_MAX = 10
"""Most publications that are taken before the next event of a request: neither waits for long."""
HEARD_SECONDS_MAX = 86_400.0
"""Age of a delivered event from which on it is not heard: nothing live looks back further."""
SILENT_SECONDS = 5.0
"""Time in which a grabber that numbers its events asks to store them; one of 0.2 never does."""
TICK_SECONDS = 0.05
"""Longest wait of a thread for something to do."""


class Intake:
    """Takes events into the journal; the bus delivers to its ``inbox``.

    Run `work` and `store`, each in a thread; or call `step` and `store_waiting`.

    hear: observes an event, and predicts; True says that it is delivered and was not heard before.
    match: matches entries that were heard, until a function returns True.
    learn: takes stored entries, in the journal's order. It must not block.
    rewind: returns the command that takes event time back to the given Unix seconds.
    steady: a clock that never steps.
    """

    def __init__(
        self,
        numbers: Numbers,
        cameras: Cameras,
        names: Names,
        backlogs: Backlogs,
        event_clock: EventClock,
        writer: JournalWriter,
        limits: Limits,
        hear: Callable[[Event, bool], None],
        match: Callable[[Callable[[], bool]], None],
        learn: Callable[[list[Received]], None],
        rewind: Callable[[float], Rewind],
        clock: Clock,
        steady: Clock,
    ) -> None:
        self.numbers = numbers
        self.cameras = cameras
        self.names = names
        self.backlogs = backlogs
        self.event_clock = event_clock
        self.writer = writer
        self.limits = limits
        self._hear_event = hear
        self._match = match
        self._learn = learn
        self._rewind_to = rewind
        self._clock = clock
        self._steady = steady
        self.alive: set[str] = set()
        """Cameras whose grabber is on the bus."""
        self._silent: dict[str, float] = {}  # grabber that has not asked yet -> since when
        self.too_old: dict[str, str] = {}
        """Camera -> that its grabber is too old, in words."""
        self.rejects = Rejects()
        self.counts = Counter(received=0, stored=0, duplicate=0, future=0, flood=0, late=0)
        self.inbox = Inbox(cameras)
        self.turn = threading.Lock()
        """Held by `step`, and by an operator's command while it changes what a step reads."""
        self.commands = threading.Lock()
        """Held by an operator's command until it is in force."""
        self.is_storing_command = False
        """True while a command is stored: publications are heard, and all else waits. It changes
        between two steps only.
        """
        self.queue = StoreQueue()
        self._publications: deque[tuple[CameraIntake, Received]] = deque()  # wait for a command
        self._ready: list[Received] = []  # what goes into the queue with this step
        self._answers = PendingRequests(numbers, cameras, self._room, self.alive, steady)

    def on_alive(self, camera: str, alive: bool) -> None:
        """Take note that a grabber has appeared on the bus, or vanished."""
        self.too_old.pop(camera, None)
        self._silent.pop(camera, None)
        if not alive:
            self.alive.discard(camera)
            if (state := self.cameras.get(camera)) is not None:
                state.hello = ""  # the next one may be older
        elif len(self.alive) < self.limits.cameras_max:
            self.alive.add(camera)

    def missing(self, declarations: TopologySettings, learner_cameras: Set[str]) -> list[str]:
        """Return a warning of declared names that no camera has, a sentence; else none.

        learner_cameras: cameras of the newest version.
        """
        cameras = learner_cameras | {camera.name for camera in self.cameras.all()}
        return missing_names(declarations, self.names.state, cameras)

    def work(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Move what is received on until ``stopping``, and once more at the end."""
        while not stopping.is_set():
            if not self._is_busy():
                self.inbox.wait(TICK_SECONDS)
            self.step()
            self._match(self._is_busy)
            beat()
        with self.commands:
            self.step()
        self.queue.close()

    def store(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Store what is in the queue until `work` has ended, or storing has failed for good."""
        while not self.queue.is_finished and self.store_waiting(stopping, beat):
            beat()

    def step(self) -> None:
        """Move what was received on, up to the queue of what is to be stored."""
        with self.turn:
            wall = self._clock()
            now = self._steady()

            if not self.is_storing_command and self.event_clock.was_set_back(wall, now):
                self._rewind(wall)

            # 1. Take publications; what follows waits for an operator's command.
            self._take_published()
            if self.is_storing_command:
                return

            # 2. Take requests.
            enough = self.counts["received"] + TAKEN_AT_ONCE_MAX
            while self.counts["received"] < enough and (request := self.inbox.take_request()):
                self._take(*request, wall, now)
            self._answers.end_held(now)
            self._note_too_old(now)

            # 3. Backlogs to wait for, and time that passes without events.
            ready, self._ready = self._ready, []
            if ready:
                self.event_clock.note_taken(ready, now)
            else:
                ready = self.event_clock.note_quiet(wall, now)
            waits = self.backlogs.changed(
                wall, now, self.names.present, self.inbox.has_request, self.alive
            )
            self.queue.put([*waits, *ready])

    def store_waiting(
        self, stopping: threading.Event, beat: Beat = no_beat, seconds: float = TICK_SECONDS
    ) -> bool:
        """Store one transaction's worth and answer; return False if that failed for good.

        seconds: longest wait for something to store.
        """
        # 4. Store.
        ready = self.queue.take(COMMIT_EVENTS_MAX, seconds, self.limits.commit_seconds)
        entries = [item.entry for item in ready]
        meta: dict[str, str] = {}
        for item in ready:
            meta |= item.meta
        new = self.writer.store(entries, stopping, beat, meta)
        if new is None:
            return False
        if len(new) < len(entries):  # after a rescue, some may be there already
            ids = set(map(id, new))
            ready = [item for item in ready if id(item.entry) in ids]
        self.note_stored(ready)

        # 5. Answer.
        for stream, seq in highest_numbers(entries).items():
            self.numbers.note_stored(*stream, seq)
        self.queue.done()
        for name in {entry.camera for entry in entries}:
            self._answers.note_stored(name)
        self.writer.prune(self.names.state.erased)
        return True

    def _take(self, name: str, content: bytes, reply: Reply, wall: float, now: float) -> None:
        """Take a request's events; answer it at once if there is nothing to wait for."""
        answers = self._answers
        try:
            request = request_of(name, content)
        except codec.Rejected as error:
            self.rejects.add(error.reason, f"store/{name}", str(error), content)
            reply(answers.encode({}, "malformed", str(error)))
            return
        camera = self.cameras.register(name, now, spooled=True)
        self.too_old.pop(name, None)
        self._silent.pop(name, None)
        if camera is None:
            reply(answers.encode({}, "cameras", self.cameras.refused_reason(now)))
            return
        if reason := self.event_clock.reason(wall):
            reply(answers.encode({}, "clock", reason))
            return
        if isinstance(request, Hello):
            camera.hello = request.number
            camera.is_new = True
            reply(answers.encode({boot: self.numbers.stored(name, boot) for boot in request.boots}))
            return
        if request.number != camera.hello:
            reply(answers.encode({}, "hello", "another hello has come since"))
            return
        if len(request.events) > self._room():
            reply(answers.encode({}, "busy", "too many events wait to be stored"))
            return

        # Take the events, unless some before them were never taken.
        new = self.numbers.take(name, request)
        if new is None:
            reply(answers.encode({request.boot: self.numbers.stored(name, request.boot)}))
            return
        up_to = request.events[-1][0] if request.events else request.after
        answers.wait_for_storage(camera, Pending(request.boot, up_to, reply, now))
        self.counts["received"] += len(request.events)
        self.counts["duplicate"] += len(request.events) - len(new)
        events = [spooled_event(name, request.boot, seq, raw, self.rejects) for seq, raw in new]
        for item in events:
            self._put(camera, item, wall)
        camera.more, camera.asked = request.more, now
        oldest = next((item.event.t for item in events if item.event is not None), None)
        self.backlogs.note_request(camera, oldest, wall, now)
        answers.note_stored(name)
        self._take_published()
        present = present_of(wall, self.event_clock.newest)
        for item in events:  # a publication waits for one of these events, not for all
            event = item.event
            if event is not None and present - event.t < HEARD_SECONDS_MAX:
                self._hear(camera, event, request.boot, item.entry.seq, wall, is_delivered=True)
                self._take_published()

    def _take_published(self) -> None:
        """Hear publications, and take those that no spool delivers, once no command is stored."""
        if not self.inbox.has_publications and not self._publications:
            return
        wall, now = self._clock(), self._steady()
        for name, content in self.inbox.take_published(HEARD_AT_ONCE_MAX):
            labels: list[codec.Rejected] = []
            try:
                event = event_of(name, content, labels.append)
            except codec.Rejected as error:
                self._reject_published(name, content, error)
                continue
            camera = self.cameras.register(name, now)
            if camera is not None and not (event.spooled and event.seq is None):
                self._hear(camera, event, event.boot, event.seq, wall)
            if event.spooled:  # it is delivered as well
                continue
            for label in labels:
                self.rejects.add(label.reason, f"event/{name}", str(label), content)
            self._store_published(name, content, event, camera, wall)
        while self._publications and not self.is_storing_command:
            self._put(*self._publications.popleft(), wall)

    def _hear(
        self,
        camera: CameraIntake,
        event: Event,
        boot: str | None,
        seq: int | None,
        wall: float,
        is_delivered: bool = False,
    ) -> None:
        """Pass an event on for predictions, unless it was heard before or is not to be learned."""
        present_event = self.names.renamed(event)
        if present_event is None or event.t - wall > self.limits.future_seconds_max:
            return
        if boot is not None and seq is not None and not camera.heard.add(boot, seq):
            return
        if camera.heard_seconds.take(event.t):
            self._hear_event(present_event, is_delivered)

    def _reject_published(self, name: str, content: bytes, error: codec.Rejected) -> None:
        """Count a publication that is not taken."""
        self.counts["received"] += 1
        self.rejects.add(error.reason, f"event/{name}", str(error), content)

    def _store_published(
        self, name: str, content: bytes, event: Event, camera: CameraIntake | None, wall: float
    ) -> None:
        """Take an event that no spool delivers.

        camera: None if there are too many.
        """
        try:
            if camera is None:
                raise codec.Rejected("too-many-cameras", "limits.cameras_max is reached")
            if reason := self.event_clock.reason(wall):
                raise codec.Rejected("clock", reason)
            if self._room() < 1:
                raise codec.Rejected("busy", "too many events wait to be stored")
        except codec.Rejected as error:
            self._reject_published(name, content, error)
            return
        self.counts["received"] += 1
        boot, seq = event.boot, event.seq
        if seq is not None and name in self.alive and not camera.hello:
            self._silent.setdefault(name, self._steady())
        if boot is not None and seq is not None and not self.numbers.take_one(name, boot, seq):
            self.counts["duplicate"] += 1
            return
        self._publications.append(
            (camera, Received(Entry("event", name, boot, seq, content), event))
        )

    def _put(self, camera: CameraIntake, item: Received, wall: float) -> None:
        """Put an entry of a camera among those to be stored, under its present name."""
        event = item.event
        if event is not None and not camera.note_time(
            event.t, wall, self.limits.future_seconds_max
        ):
            item = item.set_aside()
        for output in self.names.apply(item):
            self._ready += self._cut_flood(output)

    def _cut_flood(self, item: Received) -> list[Received]:
        """Return the entry; if its camera sends too much, one with the number alone, if any."""
        if item.event is None:
            self.counts["future"] += item.entry.kind == "future"
            return [item]
        if self.cameras.count(item.event):
            return [item]
        self.counts["flood"] += 1
        if item.entry.seq is None:
            return []
        return [item.only_number()]

    def _note_too_old(self, now: float) -> None:
        """Note and log the cameras whose grabbers number events and do not ask to store them."""
        for name, since in list(self._silent.items()):
            if now - since >= SILENT_SECONDS and name not in self.too_old:
                words = f"camera {name}: its grabber is too old for this daemon: upgrade it"
                self.too_old[name] = words
                log.warning("%s", words)

    def _rewind(self, wall: float) -> None:
        """Take event time back, as this machine's clock was set back to ``wall``."""
        for camera in self.cameras.all():
            camera.reached = min(camera.reached, wall)
        if self.event_clock.newest > wall:
            self.event_clock.newest = wall
            self.backlogs.waited_cameras = frozenset()
            self.queue.put([command_received(self._rewind_to(wall), {})])

    def note_stored(self, ready: Sequence[Received]) -> None:
        """Count the stored events, for status and answers, and pass them to the learner."""
        for item in ready:
            late = self.event_clock.note_stored(item)
            is_refused = item.entry.kind in ("refused", "future")
            if not (late or is_refused):
                continue
            self.counts["late"] += late
            camera = self.cameras.get(item.entry.camera)
            if camera is not None and (pending := camera.pending) is not None:
                pending.late += late
                pending.refused += is_refused
        self.counts["stored"] += sum(item.event is not None for item in ready)
        if ready:
            self._learn(list(ready))

    def _is_busy(self) -> bool:
        """Return True if there is something to hear, or to take."""
        inbox = self.inbox
        return inbox.has_publications if self.is_storing_command else inbox.has_messages

    def _room(self) -> int:
        """Return how many further events may be taken."""
        return EVENTS_MAX - len(self._publications) - len(self._ready) - self.queue.waiting
