"""Merge the backlogs of several cameras into one order.

When the daemon or the network was away, every spool delivers its backlog, some sooner than others.
If events were learned in the order of arrival, the first backlog would make all others late. So
while backlogs come in, ready events wait; they are released in order of time, up to the time that
every camera with more events has reached. A backlog that ends before the last released event is
late anyway, so nothing waits for it.
"""

from __future__ import annotations

import collections
import heapq
import math
from collections.abc import Callable, Sequence

from msgspec import Struct, field

from camtopod.serve.ingest.camera_registry import Received

BACKLOG_SECONDS = 2.0
"""A spool's answer that spans more event time than this is a backlog."""
SETTLE_SECONDS = 1.5
"""Time to wait for other cameras, after the first answer with a backlog and after the last."""
STALLED_SECONDS = 5.0
"""Time after which a camera that has more events, but does not deliver them, is not waited for.

If no camera has more, it is the longest wait for other cameras.
"""
HOLD_SECONDS_MAX = 120.0
"""Longest wait of all: a flooding camera may never come to an end."""


class _Backlog(Struct):
    """The backlog of one camera.

    waiting: event times, made to rise, and events.
    reached: event time up to which the camera has delivered everything, while it has ``more``.
    answered: when it delivered last.
    """

    waiting: collections.deque[tuple[float, Received]] = field(default_factory=collections.deque)
    reached: float = -math.inf
    more: bool = False
    answered: float = -math.inf


class BacklogMerger:
    """Merges backlogs; at most ``events_max`` events of one camera wait.

    ``now`` is of a clock that never steps.
    """

    def __init__(self, events_max: int) -> None:
        self._events_max = events_max
        self._backlogs: dict[str, _Backlog] = {}
        self._released = -math.inf
        self._began: float | None = None
        self._settled = 0.0

    def note_answer(self, camera: str, times: Sequence[float], more: bool, now: float) -> None:
        """Note that a spool has delivered events of these times, and whether it has ``more``."""
        backlog = self._backlogs.get(camera)
        if times and max(times) > self._released and max(times) - min(times) > BACKLOG_SECONDS:
            self._began = now if self._began is None else self._began
            self._settled = min(now + SETTLE_SECONDS, self._began + STALLED_SECONDS)
            backlog = self._backlogs.setdefault(camera, _Backlog())
        if backlog is not None:
            backlog.more, backlog.answered = more, now
            backlog.reached = max([backlog.reached, *times])

    def rewind(self, to: float) -> None:
        """Take event time back to ``to`` (Unix seconds)."""
        self._released = min(self._released, to)

    def is_full(self, camera: str) -> bool:
        """Return True if no more events of a camera can wait."""
        backlog = self._backlogs.get(camera)
        return backlog is not None and len(backlog.waiting) >= self._events_max

    def release(self, ready: list[Received], now: float, room: Callable[[], int]) -> list[Received]:
        """Return the events to pass on: of these, and of those that wait.

        Events of one camera stay in order. While backlogs are merged, at most ``room()`` events are
        returned.
        """
        # While backlogs are merged, all events queue by camera.
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

        # Note the newest event time that was passed on.
        newest = max(
            (received.event.t for received in ready if received.event is not None),
            default=-math.inf,
        )
        self._released = max(self._released, newest)
        return ready

    @property
    def waiting(self) -> int:
        """Number of events that wait."""
        return sum(len(backlog.waiting) for backlog in self._backlogs.copy().values())

    def _horizon(self, now: float) -> float:
        """Return the event time up to which all expected events have come."""
        assert self._began is not None
        if now - self._began >= HOLD_SECONDS_MAX:
            return math.inf
        if now - self._began < SETTLE_SECONDS:
            return -math.inf

        # A camera with waiting events is not stalled: it is not asked for more than may wait.
        for one in self._backlogs.values():
            one.answered = now if one.waiting else one.answered

        # Wait for cameras that have more, or else until the others have had time to answer.
        come = [
            one.reached
            for one in self._backlogs.values()
            if one.more and now - one.answered < STALLED_SECONDS
        ]
        if come or any(map(self.is_full, self._backlogs)):
            return min(come, default=math.inf)
        return math.inf if now >= self._settled else -math.inf

    def _merged(self, horizon: float, most: int) -> list[Received]:
        """Return up to ``most`` waiting events up to ``horizon``, by time.

        If none is left, and none is expected, the merge ends.
        """
        if horizon == -math.inf:
            return []

        # Merge the cameras by the times of their first waiting events.
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

        # The merge ends.
        if horizon == math.inf and not heap:
            self._backlogs.clear()
            self._began = None
        return released
