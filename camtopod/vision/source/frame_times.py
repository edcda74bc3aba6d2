"""When was this frame captured? From its presentation stamp, anchored to arrivals.

Frames arrive late, never early. So over one connection the smallest (arrival - stamp) is the best
guess of how the source's time base lies against ours, and everything above it is delay. The minimum
runs over the last half minute: it follows a drifting time base, or one that runs at a wrong rate,
and forgets the burst of old frames after opening.
"""

from __future__ import annotations

import math
from collections import deque

WINDOW_SECONDS = 30.0
JUMP_SECONDS = 5.0
"""Stamps that go back, or forward by this much more than arrivals, belong to a new time base."""
LAG_SECONDS_MAX = 10.0
"""A frame that would be older than this has a stamp not to be trusted."""


class StampClock:
    """Capture times of one connection, on the clock of the arrivals (seconds; monotonic)."""

    def __init__(self) -> None:
        self._minima: deque[tuple[float, float]] = deque()
        """(arrival, arrival - stamp), both rising: the candidates for the minimum of the window."""
        self._last: tuple[float, float] | None = None
        self.resets = 0
        self.untrusted = 0

    def see(self, stamp: float, arrival: float) -> None:
        """A frame with presentation time ``stamp`` (seconds) arrived at ``arrival``."""
        if not math.isfinite(stamp) or stamp <= 0.0:  # the first frames of a stream have none
            return
        if self._last is not None:
            step, elapsed = stamp - self._last[0], arrival - self._last[1]
            if step <= 0.0 or step > elapsed + JUMP_SECONDS:
                self._minima.clear()
                self.resets += 1
        self._last = (stamp, arrival)
        offset = arrival - stamp
        while self._minima and self._minima[-1][1] >= offset:
            self._minima.pop()
        self._minima.append((arrival, offset))
        while self._minima[0][0] < arrival - WINDOW_SECONDS:
            self._minima.popleft()

    def captured(self, stamp: float, arrival: float) -> float:
        """Capture time of a frame that was seen; its arrival where its stamp says nothing."""
        if not math.isfinite(stamp) or stamp <= 0.0 or not self._minima:
            self.untrusted += 1
            return arrival
        captured = stamp + self._minima[0][1]
        if not arrival - LAG_SECONDS_MAX <= captured <= arrival:
            self.untrusted += 1
            return arrival
        return captured
