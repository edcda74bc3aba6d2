"""Order the events of each stream, that is of each (camera, boot), by their seq.

The next event is ready; an earlier one is a duplicate; a later one waits until the gap before it is
filled from the publisher's spool. No I/O, no clock. Of each camera only the streams received from
last are followed, so that years of nightly reboots do not fill the memory.
"""

from __future__ import annotations

import collections
from collections.abc import Sequence
from typing import Generic, Literal, TypeVar

from msgspec import Struct

FIRST_SEQS = (0, 1)
"""First seqs that a new stream may begin with; a higher one means a gap."""
JUMP_MAX = 1_000_000
"""Largest gap; a seq further ahead is an error.

To trust it would make all later events below it duplicates.
"""
COUNT_MAX = 2**63 - 1
"""Largest value of the counter of lost events.

A spool may claim any number, but a status holds no larger one.
"""

Verdict = Literal["ready", "duplicate", "held", "dropped", "refused", "jump"]
"""What `Streams.add` makes of an event; see there."""
Key = tuple[str, str]
"""A stream: (camera, boot)."""
T = TypeVar("T")


class _Stream(Struct):
    """State of one stream.

    next: the lowest seq that is not ready yet; None if the stream was never seen.
    held: events that wait behind a gap, by seq.
    gap_since: when the present gap appeared.
    lacks_next: the spool does not have the event ``next``.
    goes_on: the next seq that the spool has; None if it has none.
    unknown: held seqs that the spool does not have either.
    """

    next: int | None
    held: dict[int, object]
    gap_since: float = 0.0
    lacks_next: bool = False
    goes_on: int | None = None
    unknown: frozenset[int] = frozenset()


class Streams(Generic[T]):
    """The streams that are followed; items are of any type.

    Beyond the limits, a new stream takes the place of the one not received from for longest, which
    is forgotten. Streams with held events are never forgotten; if there are only such, the events
    of the new stream are refused.

    stored: highest seq of each (camera, boot) in the journal; those received last are at the end.
    held_max: most items of one camera that wait behind gaps.
    streams_max, boots_max: most streams in all, and of one camera.
    """

    def __init__(
        self,
        stored: dict[Key, int],
        held_max: int,
        streams_max: int,
        boots_max: int,
    ) -> None:
        self._held_max, self._streams_max, self._boots_max = held_max, streams_max, boots_max
        # The stream received from last is the last one, here and in _boots.
        self._streams: dict[Key, _Stream] = {}
        self._boots: dict[str, dict[str, None]] = {}
        self._held: collections.Counter[str] = collections.Counter()
        self._gaps: set[Key] = set()
        self._forgotten: list[Key] = []
        self.lost = 0
        """Number of events given up: no spool has them."""
        self.unknown = 0
        """Number of events dropped that waited behind a gap but are not in their spool."""
        for key, seq in stored.items():
            if self._make_room(key):
                self._add(key, _Stream(seq + 1, {}))

    def add(self, key: Key, seq: int, item: T, now: float) -> tuple[Verdict, list[T]]:
        """Take one event of stream ``key``; return its verdict and what is ready now, in order.

        now (seconds): of a clock that never steps.

        The verdicts:

        ready: it is the next one; it is returned, with the held events that follow it.
        duplicate: an event with this seq was ready before, is held, or was given up as lost.
        held: it waits behind a gap.
        dropped: too many events of the camera are held; it is not kept and has to be pulled later.
        refused: its stream is new, and there is no room for another stream (`Streams`).
        jump: its seq is too far ahead to be true; it is not kept.
        """
        # A new stream begins with its first seq; it may have to replace another.
        stream = self._touch(key)
        if stream is None:
            return "refused", []
        if stream.next is None and seq in FIRST_SEQS:
            stream.next = seq

        # The next event, or an earlier one.
        if stream.next is not None and seq < stream.next:
            return "duplicate", []
        if seq == stream.next and not stream.held:  # the usual case
            stream.next, stream.lacks_next, stream.goes_on = seq + 1, False, None
            return "ready", [item]
        if seq == stream.next:
            self._hold(key, stream, seq, item)
            return "ready", self._release(key, stream, now)

        # An event behind a gap.
        if seq in stream.held:
            return "duplicate", []
        if stream.next is not None and seq - stream.next > JUMP_MAX:
            return "jump", []
        if self._held[key[0]] >= self._held_max:
            return "dropped", []
        if not stream.held:
            stream.gap_since = now
            self._gaps.add(key)
        self._hold(key, stream, seq, item)
        return "held", []

    def skip_before(self, key: Key, first: int, now: float) -> list[T]:
        """Return what becomes ready as the spool has nothing below ``first``: the rest is lost."""
        stream = self._touch(key)
        if stream is None or (stream.next is not None and stream.next >= first):
            return []
        return self._skip_to(key, stream, first, now)

    def note_answer(
        self, key: Key, asked_from: int, seqs: Sequence[int], more: bool, knows: bool = True
    ) -> None:
        """Note the ``seqs`` (rising) that a spool has from ``asked_from`` on, and perhaps ``more``.

        If the gap is still there, the spool cannot fill it.

        knows: the spool knows the boot. If it does not, its answer means nothing for held events.
            If it does, it had every event before it was published, so a held event that is missing
            there twice is in no spool.
        """
        stream = self._streams.get(key)
        if stream is None or not stream.held or (stream.next or 0) < asked_from:
            return

        # The first event from the gap on that the spool has.
        following = next((seq for seq in seqs if seq >= (stream.next or 0)), None)
        if following is None and more:
            return

        # It has none: drop held events that it lacks for the second time.
        if following is None and knows:
            for seq in stream.unknown & stream.held.keys():
                self._unhold(key, stream, seq)
                self.unknown += 1
            stream.unknown = frozenset(stream.held)
            if not stream.held:
                self._gaps.discard(key)
            return

        # It has later ones: the gap cannot be filled.
        stream.lacks_next, stream.goes_on = True, following

    def give_up_gaps(self, now: float, gap_seconds: float, has_spool: set[str]) -> list[T]:
        """Return what becomes ready as gaps older than ``gap_seconds`` cannot be filled.

        has_spool: cameras with a spool; their gaps wait until the spool has said that it lacks the
            event.
        """
        ready: list[T] = []
        for key in list(self._gaps):
            stream = self._streams[key]
            hopeless = stream.lacks_next or key[0] not in has_spool
            if hopeless and now - stream.gap_since >= gap_seconds:
                lowest = min(stream.held)
                ready += self._skip_to(
                    key, stream, lowest if stream.goes_on is None else stream.goes_on, now
                )
        return ready

    def next_to_pull(self, camera: str) -> tuple[str, int] | None:
        """Return (boot, lowest seq not ready yet) of a camera's newest stream, to be pulled.

        Any thread.
        """
        boots = list(self._boots.get(camera, ()))
        stream = self._streams.get((camera, boots[-1])) if boots else None
        return None if stream is None else (boots[-1], stream.next or 0)

    def boots(self, camera: str) -> list[str]:
        """Return the boots of a camera that are followed. Any thread."""
        return list(self._boots.get(camera, ()))

    def take_forgotten(self) -> list[Key]:
        """Return the streams that were forgotten since the last call."""
        keys, self._forgotten = self._forgotten, []
        return [key for key in keys if key not in self._streams]

    @property
    def gaps(self) -> set[str]:
        """Cameras with a gap."""
        return {camera for camera, _ in self._gaps}

    def __len__(self) -> int:
        return len(self._streams)

    def _touch(self, key: Key) -> _Stream | None:
        """Return the stream, now the one received from last; None if there is no room for it."""
        stream = self._streams.pop(key, None)
        if stream is None:
            if not self._make_room(key):
                return None
            stream = _Stream(None, {})
        elif next(reversed(self._boots[key[0]])) == key[1]:  # the usual case
            self._streams[key] = stream
            return stream
        self._add(key, stream)
        return stream

    def _add(self, key: Key, stream: _Stream) -> None:
        self._streams[key] = stream
        boots = self._boots.setdefault(key[0], {})
        boots.pop(key[1], None)
        boots[key[1]] = None

    def _make_room(self, key: Key) -> bool:
        """Make room for a stream by forgetting the one not received from for longest.

        Streams with held events are kept. It is one of the same camera if that has too many, else
        any. Return False if there is none.
        """
        boots = self._boots.get(key[0], {})
        if len(boots) < self._boots_max and len(self._streams) < self._streams_max:
            return True
        of_camera = len(boots) >= self._boots_max
        others = [(key[0], boot) for boot in boots] if of_camera else self._streams
        oldest = next((other for other in others if not self._streams[other].held), None)
        if oldest is None:
            return False
        del self._streams[oldest], self._boots[oldest[0]][oldest[1]]
        if not self._boots[oldest[0]]:
            del self._boots[oldest[0]]
        self._forgotten.append(oldest)
        return True

    def _hold(self, key: Key, stream: _Stream, seq: int, item: T) -> None:
        stream.held[seq] = item
        self._held[key[0]] += 1

    def _unhold(self, key: Key, stream: _Stream, seq: int) -> T:
        """Return an event that was held, and hold it no longer."""
        self._held[key[0]] -= 1
        if not self._held[key[0]]:
            del self._held[key[0]]
        return stream.held.pop(seq)  # type: ignore[return-value]

    def _skip_to(self, key: Key, stream: _Stream, seq: int, now: float) -> list[T]:
        """Give up what is missing below ``seq``; events held below it become ready."""
        early = sorted(held for held in stream.held if held < seq)
        ready = [self._unhold(key, stream, held) for held in early]
        if stream.next is not None or ready:
            self.lost = min(self.lost + max(0, seq - (stream.next or 0) - len(ready)), COUNT_MAX)
        stream.next = seq
        return ready + self._release(key, stream, now)

    def _release(self, key: Key, stream: _Stream, now: float) -> list[T]:
        """Return the held events that are next now."""
        ready: list[T] = []
        assert stream.next is not None
        while stream.next in stream.held:
            ready.append(self._unhold(key, stream, stream.next))
            stream.next += 1
        stream.lacks_next, stream.goes_on = False, None
        if stream.held:
            stream.gap_since = now
            self._gaps.add(key)
        else:
            self._gaps.discard(key)
        return ready
