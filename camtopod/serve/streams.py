"""Order within each (camera, boot): what comes next is ready, what came before is a duplicate, what comes too
early waits for the gap to be filled from the publisher's spool. No I/O, no clock.
"""

from __future__ import annotations

from typing import Generic, Literal, TypeVar

from msgspec import Struct

FIRST_SEQS = (0, 1)
"""A stream seen for the first time may begin with one of these; a higher one is a gap."""

Verdict = Literal["ready", "duplicate", "held", "dropped", "refused"]
T = TypeVar("T")


class _Stream(Struct):
    """``next``: the lowest seq not ready yet, None for a stream never seen."""

    next: int | None
    held: dict[int, object]
    gap_since: float = 0.0
    spool_lacks_next: bool = False


class Streams(Generic[T]):
    """``stored``: the highest seq of each (camera, boot) in the journal. Items are of the caller's kind."""

    def __init__(self, stored: dict[tuple[str, str], int], held_max: int, streams_max: int) -> None:
        self._streams = {key: _Stream(seq + 1, {}) for key, seq in stored.items()}
        self._newest_boot = dict(stored.keys())
        self._gaps: set[tuple[str, str]] = set()
        self._held_max = held_max
        self._streams_max = streams_max
        self.lost = 0
        """Events given up: in nobody's spool, or from a publisher without one."""

    def offer(self, key: tuple[str, str], seq: int, item: T, now: float) -> tuple[Verdict, list[T]]:
        """One event of stream ``key``; returns its verdict and what is ready now, in order.

        ``dropped``: too many are held back already, it will have to be pulled. ``refused``: too many streams.
        """
        stream = self._streams.get(key)
        if stream is None:
            if len(self._streams) >= self._streams_max:
                return "refused", []
            stream = self._streams[key] = _Stream(None, {})
        self._newest_boot[key[0]] = key[1]
        if stream.next is None and seq in FIRST_SEQS:
            stream.next = seq
        if stream.next is not None and seq < stream.next:
            return "duplicate", []
        if seq == stream.next:
            stream.held[seq] = item
            return "ready", self._release(key, stream, now)
        if seq in stream.held:
            return "duplicate", []
        if len(stream.held) >= self._held_max:
            return "dropped", []
        if not stream.held:
            stream.gap_since = now
            self._gaps.add(key)
        stream.held[seq] = item
        return "held", []

    def begins_at(self, key: tuple[str, str], first: int, now: float) -> list[T]:
        """The spool says that it has nothing below ``first``: what is still missing there is lost."""
        stream = self._streams.get(key)
        if stream is None:
            if len(self._streams) >= self._streams_max:
                return []
            stream = self._streams[key] = _Stream(None, {})
            self._newest_boot[key[0]] = key[1]
        if stream.next is not None and stream.next >= first:
            return []
        return self._skip_to(key, stream, first, now)

    def answered(self, key: tuple[str, str], asked_from: int) -> None:
        """A spool gave all it has from ``asked_from`` on; if the gap is still there it cannot fill it."""
        stream = self._streams.get(key)
        if stream is not None and stream.held and (stream.next is None or stream.next >= asked_from):
            stream.spool_lacks_next = True

    def give_up(self, now: float, gap_seconds: float, has_spool: set[str]) -> list[T]:
        """What becomes ready because gaps older than ``gap_seconds`` cannot be filled by anybody.

        A camera in ``has_spool`` is waited for until its spool has said that it lacks the event.
        """
        ready: list[T] = []
        for key in list(self._gaps):
            stream = self._streams[key]
            hopeless = stream.spool_lacks_next or key[0] not in has_spool
            if hopeless and now - stream.gap_since >= gap_seconds:
                ready += self._skip_to(key, stream, min(stream.held), now)
        return ready

    def wanted(self, camera: str) -> tuple[str, int] | None:
        """(boot, lowest seq not ready yet) of a camera's newest stream, to ask its spool for."""
        boot = self._newest_boot.get(camera)
        if boot is None:
            return None
        return boot, self._streams[camera, boot].next or 0

    @property
    def gaps(self) -> set[str]:
        """The cameras with a gap."""
        return {camera for camera, _ in self._gaps}

    def __len__(self) -> int:
        return len(self._streams)

    def _skip_to(self, key: tuple[str, str], stream: _Stream, seq: int, now: float) -> list[T]:
        """Give up what is missing below ``seq``; what is held below it is ready too."""
        early = sorted(held for held in stream.held if held < seq)
        ready: list[T] = [stream.held.pop(held) for held in early]  # type: ignore[misc]
        if stream.next is not None or ready:
            self.lost += max(0, seq - (stream.next or 0) - len(ready))
        stream.next = seq
        return ready + self._release(key, stream, now)

    def _release(self, key: tuple[str, str], stream: _Stream, now: float) -> list[T]:
        ready: list[T] = []
        assert stream.next is not None
        while stream.next in stream.held:
            ready.append(stream.held.pop(stream.next))  # type: ignore[arg-type]
            stream.next += 1
        if stream.held:
            stream.gap_since = now
            stream.spool_lacks_next = False
            self._gaps.add(key)
        else:
            self._gaps.discard(key)
        return ready
