"""Track how far each stream is stored, and publish acknowledgements at intervals."""

from __future__ import annotations

import collections
from collections.abc import Iterable

from msgspec import Struct
from msgspec.structs import asdict

from camtopod.admin import Command, Forget, Rename, Reset
from camtopod.event_time import EventTime, EventTimeState, microseconds
from camtopod.records import Ack
from camtopod.serve.bus import Bus
from camtopod.serve.ingest.camera_registry import Received
from camtopod.serve.ingest.sequencing import Key
from camtopod.serve.runtime import Beat


class Counts(Struct):
    """Counters of the events of one stream since the start; see `Ack`."""

    accepted: int = 0
    late: int = 0
    duplicate: int = 0
    refused: int = 0


class Acks:
    """The acknowledgements of all streams.

    One thread calls `duplicate` and `forget`, another `note_stored` and `publish`; `repeat` may be
    called from any thread.

    stored: the highest stored seq of each stream, as of `Journal.streams`.
    daemon: name of this daemon.
    event_time: event time as the learner has it after the stored events.
    """

    def __init__(
        self,
        bus: Bus,
        stored: dict[Key, int],
        daemon: str,
        event_time: EventTime,
    ) -> None:
        self._bus, self._daemon, self._event_time = bus, daemon, event_time
        self.stored = stored
        """The highest seq of each stream that is stored."""
        self._counts: dict[Key, Counts] = {}
        self._dirty = set(stored)
        self._again: set[Key] = set()
        self._forgotten: collections.deque[Key] = collections.deque()
        self._next = 0.0

    def note_stored(self, ready: Iterable[Received]) -> None:
        """Note that these are committed to the journal, before the learner gets them.

        Follows event time as the learner will, to tell which events are late. `publish` sends the
        acks later.
        """
        for received in ready:
            entry, event, late = received.entry, received.event, False

            # Follow event time as the learner does.
            if event is not None:
                late = not self._event_time.note(microseconds(event.t), event.camera)
            elif received.advance is not None:
                self._event_time.advance(microseconds(received.advance))
            elif received.rewind is not None:
                self._event_time.rewind(microseconds(received.rewind.to))
            elif received.command is not None:
                self._follow(received.command)

            # Count the event in its stream.
            if entry.boot is None or entry.seq is None:
                continue
            key = (entry.camera, entry.boot)
            self.stored[key] = entry.seq
            self._dirty.add(key)
            counts = self._of(key)
            if event is None:
                counts.refused += 1
            elif late:
                counts.late += 1
            else:
                counts.accepted += 1

    def repeat(self, key: Key) -> None:
        """Acknowledge a stream again, as the ack may have been lost. Any thread."""
        self._again.add(key)

    def duplicate(self, key: Key) -> None:
        """Count an event that was received before, and acknowledge its stream again."""
        self._of(key).duplicate += 1
        self._again.add(key)

    def forget(self, keys: Iterable[Key]) -> None:
        """Drop streams that are no longer followed."""
        self._forgotten.extend(keys)

    def publish(self, now: float, interval: float, beat: Beat) -> None:
        """Publish the acks of some streams, at most once in ``interval`` seconds.

        These are the streams of which events were stored since the last call, those that `repeat`
        was called for, and those of duplicates (`duplicate`); at first, all that were stored before
        the start.

        now (seconds): of a clock that never steps.
        """
        if now < self._next:
            return
        self._next = now + interval

        # Publish the acks that changed or were asked for again.
        while self._again:
            key = self._again.pop()
            if key in self.stored:
                self._dirty.add(key)
        for key in self._dirty:
            camera, boot = key
            ack = Ack(camera, boot, self.stored[key], self._daemon, **asdict(self._of(key)))
            self._bus.publish(f"ack/{camera}", ack, "ack")
            beat()
        self._dirty.clear()

        # Drop forgotten streams.
        while self._forgotten:
            key = self._forgotten.popleft()
            self.stored.pop(key, None)
            self._counts.pop(key, None)

    def _follow(self, command: Command) -> None:
        """Change event time as an operator's command does in the learner."""
        match command:
            case Forget(camera):
                self._event_time.forget({camera})
            case Rename(old, new):
                self._event_time.rename(old, new)
            case Reset():
                self._event_time.load(EventTimeState())
            case _:
                pass

    def _of(self, key: Key) -> Counts:
        counts = self._counts.get(key)
        return self._counts.setdefault(key, Counts()) if counts is None else counts
