"""The daemon's path of an event without threads, bus and learner: a journal on disk, and clocks
that a test sets."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from camtopod import codec
from camtopod.admin import Rewind
from camtopod.config import Limits
from camtopod.event_time import EventTime, microseconds
from camtopod.records import Event
from camtopod.serve.ingest import (
    Backlogs,
    Cameras,
    EventClock,
    Intake,
    Names,
    Numbers,
    Received,
    backlogs,
    read_names,
)
from camtopod.serve.requests import Answer, Batch, Hello
from camtopod.serve.storage import Journal, JournalWriter

START = 1_700_000_000.0
"""Unix seconds at which the clocks of a test begin."""
LATENESS = 5.0


class Request:
    """A request on its way: ``answer`` is None until it is answered."""

    def __init__(self) -> None:
        self.answer: Answer | None = None

    def reply(self, content: bytes) -> None:
        assert self.answer is None, "a request is answered once"
        self.answer = msgspec.msgpack.decode(content, type=Answer)


def answer_of(request: Request) -> Answer:
    """Return the answer to a request that has been answered."""
    assert request.answer is not None
    return request.answer


class IntakeBench:
    """An `Intake` with its journal in ``directory``.

    wall, now: this machine's clock and the steady one, set by the test.
    learned: the entries that the learner has got, in order.
    heard: the events that predictions have got, in order.
    """

    def __init__(
        self,
        directory: Path,
        limits: Limits | None = None,
        wall: float = START,
        now: float = 1_000.0,
        settled: bool = True,
    ) -> None:
        self.directory = directory
        self.limits = limits or Limits(commit_seconds=0.0)
        self.wall = wall
        self.now = now
        self.learned: list[Received] = []
        self.heard: list[Event] = []
        self.start(settled)

    def start(self, settled: bool = True) -> None:
        """Start on what the journal has; ``settled``: the first seconds have passed already."""
        self.journal = Journal(self.directory)
        future = self.limits.future_seconds_max
        learned = EventTime(LATENESS, future)
        for _, entry in self.journal.entries():
            if entry is not None and entry.kind == "event":
                learned.note(microseconds(codec.event_from_bytes(entry.raw).t), entry.camera)
            elif entry is not None and entry.kind == "waits":
                learned.wait_for(codec.read(set[str], entry.raw))
        event_clock = EventClock(learned, future, 10.0, self.wall, self.now)
        self.intake = Intake(
            Numbers(self.journal.numbers()),
            Cameras(self.limits.cameras_max),
            Names(read_names(self.journal), lambda: self.wall),
            Backlogs(LATENESS, event_clock, self.now - backlogs.SETTLE_SECONDS * settled),
            event_clock,
            JournalWriter(self.journal, lambda: self.wall),
            self.limits,
            hear=lambda event, is_delivered: self.hear(event, is_delivered),
            match=lambda is_busy: None,
            learn=self.learned.extend,
            rewind=lambda to: Rewind(to, "before", "after"),
            clock=lambda: self.wall,
            steady=lambda: self.now,
        )

    def hear(self, event: Event, is_delivered: bool) -> None:
        """Take an event for predictions."""
        self.heard.append(event)

    def stop(self) -> None:
        """Stop as a killed process does: what is not stored is gone."""
        self.journal.close()

    def restart(self) -> None:
        self.stop()
        self.start()

    def tick(self, seconds: float) -> None:
        """Let time pass on both clocks, and the daemon work."""
        self.wall += seconds
        self.now += seconds
        self.work()

    def work(self) -> None:
        """Move everything on that can move on."""
        self.intake.step()
        while self.intake.queue.waiting or self.intake.inbox.has_messages:
            assert self.intake.store_waiting(threading.Event(), seconds=0.0)
            self.intake.step()

    def ask(self, camera: str, request: Hello | Batch | bytes) -> Request:
        """Send a request, and let the daemon work."""
        sent = Request()
        content = request if isinstance(request, bytes) else codec.to_msgpack(request)
        self.intake.inbox.on_request(f"store/{camera}", content, sent.reply)
        self.work()
        return sent

    def hello(self, camera: str = "a", boots: Sequence[str] = (), number: str = "h1") -> Answer:
        return answer_of(self.ask(camera, Hello(number, list(boots))))

    def send(
        self,
        camera: str = "a",
        boot: str = "b1",
        after: int = 0,
        times: dict[int, float] | None = None,
        more: int = 0,
        number: str = "h1",
    ) -> Request:
        """Send a batch of events, given as seq -> seconds after the present."""
        events = [(seq, event_bytes(camera, self.wall + t)) for seq, t in (times or {}).items()]
        return self.ask(camera, Batch(number, boot, after, events, more))

    def store(self, times: dict[int, float], **given: Any) -> Answer:
        """Send a batch that is answered at once; arguments are those of `send`."""
        return answer_of(self.send(times=times, **given))

    def publish(self, camera: str, **fields: object) -> None:
        """Publish an event at the present, and let the daemon work."""
        event = {"camera": camera, "kind": "entry", "t": self.wall, **fields}
        self.intake.inbox.on_event(f"event/{camera}", codec.to_msgpack(event))
        self.work()

    @property
    def stored(self) -> list[tuple[str, str, int | None]]:
        """The journal's entries as (kind, camera, seq), but for those that tell whom to wait for."""
        entries = [entry for _, entry in self.journal.entries() if entry is not None]
        return [(one.kind, one.camera, one.seq) for one in entries if one.kind != "waits"]

    @property
    def waits(self) -> list[list[str]]:
        """The cameras that the learner was told to wait for, each time that this changed."""
        return [sorted(one.waited) for one in self.learned if one.waited is not None]


_tracks = itertools.count()


def event_bytes(camera: str, t: float) -> bytes:
    """Return an entry of ``camera`` at ``t``, with a track of its own."""
    return codec.to_msgpack(Event(camera, "entry", t, track=str(next(_tracks))))
