"""Order within each (camera, boot): what comes next is ready, what came before is a duplicate, what
comes too early waits for the gap to be filled from the publisher's spool. No I/O, no clock.

Of each camera the streams heard last are followed, so that years of nightly reboots fill nothing.
"""

from __future__ import annotations

import collections
from collections.abc import Callable, Sequence
from typing import Generic, Literal, TypeVar

from msgspec import Struct

FIRST_SEQS = (0, 1)
"""A stream seen for the first time may begin with one of these; a higher one is a gap."""
JUMP_MAX = 1_000_000
"""A seq further ahead than this is no gap but damage: believing it would make everything below it a
duplicate.
"""
COUNT_MAX = 2**63 - 1
"""A spool may say anything; larger numbers have no place in a status."""

Verdict = Literal["ready", "duplicate", "held", "dropped", "refused", "jump"]
Key = tuple[str, str]
T = TypeVar("T")


class _Stream(Struct):
    """``next``: the lowest seq not ready yet, None for a stream never seen.

    What the publisher's spool said of the gap: it ``lacks_next`` and goes on with ``goes_on``; the
    held seqs in ``unknown`` it has never heard of.
    """

    next: int | None
    held: dict[int, object]
    gap_since: float = 0.0
    lacks_next: bool = False
    goes_on: int | None = None
    unknown: frozenset[int] = frozenset()


class Streams(Generic[T]):
    """``stored``: the highest seq of each (camera, boot) in the journal, those heard last at the
    end.

    At most ``held_max`` items of one camera wait behind gaps. At most ``boots_max`` streams of one
    camera are followed, and ``streams_max`` altogether; one that is complete and has not been heard
    for longest gives way. Items are of the caller's kind. ``owns``: the cameras of which everything
    ought to come; of another one nobody has lost what was not heard.
    """

    def __init__(
        self,
        stored: dict[Key, int],
        held_max: int,
        streams_max: int,
        boots_max: int,
        owns: Callable[[str], bool],
    ) -> None:
        self._held_max, self._streams_max, self._boots_max, self._owns = (
            held_max,
            streams_max,
            boots_max,
            owns,
        )
        self._streams: dict[Key, _Stream] = {}  # the one heard last is last, here and in _boots
        self._boots: dict[str, dict[str, None]] = {}
        self._held: collections.Counter[str] = collections.Counter()
        self._gaps: set[Key] = set()
        self._forgotten: list[Key] = []
        self.lost = 0
        """Events given up: in nobody's spool, or from a publisher without one."""
        self.unknown = 0
        """Events thrown away that waited behind a gap and are not in the spool they should have
        come from.
        """
        for key, seq in stored.items():
            if self._room_for(key):
                self._add(key, _Stream(seq + 1, {}))

    def offer(self, key: Key, seq: int, item: T, now: float) -> tuple[Verdict, list[T]]:
        """One event of stream ``key``; returns its verdict and what is ready now, in order.

        ``dropped``: too many are held back already, it will have to be pulled. ``refused``: too
        many streams. ``jump``: too far ahead to be true.
        """
        stream = self._heard(key)
        if stream is None:
            return "refused", []
        if stream.next is None and seq in FIRST_SEQS:
            stream.next = seq
        if stream.next is not None and seq < stream.next:
            return "duplicate", []
        if seq == stream.next and not stream.held:  # as nearly always
            stream.next, stream.lacks_next, stream.goes_on = seq + 1, False, None
            return "ready", [item]
        if seq == stream.next:
            self._hold(key, stream, seq, item)
            return "ready", self._release(key, stream, now)
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

    def begins_at(self, key: Key, first: int, now: float) -> list[T]:
        """The spool says that it has nothing below ``first``: what is still missing there is
        lost.
        """
        stream = self._heard(key)
        if stream is None or (stream.next is not None and stream.next >= first):
            return []
        return self._skip_to(key, stream, first, now)

    def answered(
        self, key: Key, asked_from: int, seqs: Sequence[int], more: bool, knows: bool = True
    ) -> None:
        """A spool gave ``seqs``, rising, of what it has from ``asked_from`` on; were there
        ``more``?

        If the gap is still there it cannot fill it. A spool that does not even know the boot says
        nothing about what is held; one that does had every event before it was put, so what it
        lacks twice is nobody's.
        """
        stream = self._streams.get(key)
        if stream is None or not stream.held or (stream.next or 0) < asked_from:
            return
        following = next((seq for seq in seqs if seq >= (stream.next or 0)), None)
        if following is None and more:
            return
        if following is None and knows:
            for seq in stream.unknown & stream.held.keys():
                self._let_go(key, stream, seq)
                self.unknown += 1
            stream.unknown = frozenset(stream.held)
            if not stream.held:
                self._gaps.discard(key)
            return
        stream.lacks_next, stream.goes_on = True, following

    def give_up(self, now: float, gap_seconds: float, has_spool: set[str]) -> list[T]:
        """What becomes ready because gaps older than ``gap_seconds`` cannot be filled by anybody.

        A camera in ``has_spool`` is waited for until its spool has said that it lacks the event.
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

    def wanted(self, camera: str) -> tuple[str, int] | None:
        """(boot, lowest seq not ready yet) of a camera's newest stream, to ask its spool for. Any
        thread.
        """
        boots = list(self._boots.get(camera, ()))
        stream = self._streams.get((camera, boots[-1])) if boots else None
        return None if stream is None else (boots[-1], stream.next or 0)

    def boots(self, camera: str) -> list[str]:
        """The boots of a camera that are followed. Any thread."""
        return list(self._boots.get(camera, ()))

    def forgotten(self) -> list[Key]:
        """The streams that are not followed any more, since the last call."""
        keys, self._forgotten = self._forgotten, []
        return [key for key in keys if key not in self._streams]

    @property
    def gaps(self) -> set[str]:
        """The cameras with a gap."""
        return {camera for camera, _ in self._gaps}

    def __len__(self) -> int:
        return len(self._streams)

    def _heard(self, key: Key) -> _Stream | None:
        """The stream, now the one heard last; None if there are too many and none of them can be
        forgotten.
        """
        stream = self._streams.pop(key, None)
        if stream is None:
            if not self._room_for(key):
                return None
            stream = _Stream(None, {})
        elif next(reversed(self._boots[key[0]])) == key[1]:  # as nearly always
            self._streams[key] = stream
            return stream
        self._add(key, stream)
        return stream

    def _add(self, key: Key, stream: _Stream) -> None:
        self._streams[key] = stream
        boots = self._boots.setdefault(key[0], {})
        boots.pop(key[1], None)
        boots[key[1]] = None

    def _room_for(self, key: Key) -> bool:
        """Make room for one more, by forgetting the complete stream that has not been heard for
        longest: of the camera if it has too many, else of all.
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

    def _let_go(self, key: Key, stream: _Stream, seq: int) -> T:
        self._held[key[0]] -= 1
        if not self._held[key[0]]:
            del self._held[key[0]]
        return stream.held.pop(seq)  # type: ignore[return-value]

    def _skip_to(self, key: Key, stream: _Stream, seq: int, now: float) -> list[T]:
        """Give up what is missing below ``seq``; what is held below it is ready too."""
        early = sorted(held for held in stream.held if held < seq)
        ready = [self._let_go(key, stream, held) for held in early]
        if (stream.next is not None or ready) and self._owns(key[0]):
            self.lost = min(self.lost + max(0, seq - (stream.next or 0) - len(ready)), COUNT_MAX)
        stream.next = seq
        return ready + self._release(key, stream, now)

    def _release(self, key: Key, stream: _Stream, now: float) -> list[T]:
        ready: list[T] = []
        assert stream.next is not None
        while stream.next in stream.held:
            ready.append(self._let_go(key, stream, stream.next))
            stream.next += 1
        stream.lacks_next, stream.goes_on = False, None
        if stream.held:
            stream.gap_since = now
            self._gaps.add(key)
        else:
            self._gaps.discard(key)
        return ready
