"""Backlogs brought back into one order.

After the daemon or the network was away every spool gives what it has, one sooner than the other.
Learned as it comes, the first would make all others late. So while backlogs come in, what is ready
waits a moment, and is then released by time, as far as every camera has come that has more to give.
A backlog that ends before what has been released already is late anyway, and nobody waits for it.
"""

from __future__ import annotations

import collections
import heapq
import math
from collections.abc import Callable, Sequence

from msgspec import Struct, field

from camtopod.serve.ingest.camera_registry import Received

BACKLOG_SECONDS = 2.0
"""An answer of a spool that spans more event time than this is a backlog."""
SETTLE_SECONDS = 1.5
"""After the first answer with a backlog, and after the last, so long is waited for others."""
STUCK_SECONDS = 5.0
"""A camera that has more, and has not given it for so long, is not waited for; nor, when none has
more, for others.
"""
HOLD_SECONDS_MAX = 120.0
"""Nor is anything, longer than this altogether: a camera that floods may never come to its end."""


class _Backlog(Struct):
    """``reached``: event time up to which its camera has given all, while it has ``more``;
    ``answered``: when.
    """

    waiting: collections.deque[tuple[float, Received]] = field(default_factory=collections.deque)
    reached: float = -math.inf
    more: bool = False
    answered: float = -math.inf


class Merge:
    """At most ``events_max`` of one camera wait. ``now`` is of a clock that never steps."""

    def __init__(self, events_max: int) -> None:
        self._events_max = events_max
        self._backlogs: dict[str, _Backlog] = {}
        self._released = -math.inf
        self._began: float | None = None
        self._settled = 0.0

    def answered(self, camera: str, times: Sequence[float], more: bool, now: float) -> None:
        """A spool has given events of these times, and has ``more`` or not."""
        backlog = self._backlogs.get(camera)
        if times and max(times) > self._released and max(times) - min(times) > BACKLOG_SECONDS:
            self._began = now if self._began is None else self._began
            self._settled = min(now + SETTLE_SECONDS, self._began + STUCK_SECONDS)
            backlog = self._backlogs.setdefault(camera, _Backlog())
        if backlog is not None:
            backlog.more, backlog.answered = more, now
            backlog.reached = max([backlog.reached, *times])

    def rewind(self, to: float) -> None:
        """Event time is at ``to`` again (Unix seconds)."""
        self._released = min(self._released, to)

    def full(self, camera: str) -> bool:
        """Whether no more of a camera can wait."""
        backlog = self._backlogs.get(camera)
        return backlog is not None and len(backlog.waiting) >= self._events_max

    def release(self, ready: list[Received], now: float, room: Callable[[], int]) -> list[Received]:
        """What goes on: of these, and of what waits, then as many as there is ``room`` for. Each
        camera's in the order it came.
        """
        if self._began is not None:
            for received in ready:
                waiting = self._backlogs.setdefault(received.entry.camera, _Backlog()).waiting
                before = waiting[-1][0] if waiting else -math.inf
                waiting.append(
                    (
                        max(before, -math.inf if received.event is None else received.event.t),
                        received,
                    )
                )
            ready = self._merged(self._horizon(now), room())
        newest = max(
            (received.event.t for received in ready if received.event is not None),
            default=-math.inf,
        )
        self._released = max(self._released, newest)
        return ready

    @property
    def waiting(self) -> int:
        """Events that wait."""
        return sum(len(backlog.waiting) for backlog in self._backlogs.copy().values())

    def _horizon(self, now: float) -> float:
        """Event time up to which everything has come that is to be waited for."""
        assert self._began is not None
        if now - self._began >= HOLD_SECONDS_MAX:
            return math.inf
        if now - self._began < SETTLE_SECONDS:
            return -math.inf
        for one in self._backlogs.values():
            one.answered = (
                now if one.waiting else one.answered
            )  # it is not asked for more than may wait
        come = [
            one.reached
            for one in self._backlogs.values()
            if one.more and now - one.answered < STUCK_SECONDS
        ]
        if come or any(map(self.full, self._backlogs)):
            return min(come, default=math.inf)
        return math.inf if now >= self._settled else -math.inf

    def _merged(self, horizon: float, most: int) -> list[Received]:
        if horizon == -math.inf:
            return []
        heap = [
            (one.waiting[0][0], camera) for camera, one in self._backlogs.items() if one.waiting
        ]
        heapq.heapify(heap)
        released: list[Received] = []
        while heap and heap[0][0] <= horizon and len(released) < most:
            waiting = self._backlogs[heap[0][1]].waiting
            released.append(waiting.popleft()[1])
            if waiting:
                heapq.heapreplace(heap, (waiting[0][0], heap[0][1]))
            else:
                heapq.heappop(heap)
        if horizon == math.inf and not heap:
            self._backlogs.clear()
            self._began = None
        return released
