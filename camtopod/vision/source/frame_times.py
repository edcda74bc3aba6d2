"""Capture times of frames, from presentation stamps anchored to arrival times.

Frames arrive late, never early. Over one connection the smallest difference (arrival - stamp) is
therefore the best estimate of the offset between the source's time base and ours; any excess is
delay. The minimum is taken over the last half minute, so that it follows a drifting time base, or
one that runs at a wrong rate, and forgets the burst of old frames after opening.
"""

from __future__ import annotations

import math
from collections import deque

WINDOW_SECONDS = 30.0
"""Length of the window of the minimum."""
JUMP_SECONDS = 5.0
"""Jump of stamps that starts a new time base: backwards, or forwards by this more than arrivals."""
LAG_SECONDS_MAX = 10.0
"""Longest plausible delay of a frame; a stamp that implies more is not trusted."""


class StampClock:
    """Capture times of one connection, on the clock of the arrivals (seconds; monotonic)."""

    def __init__(self) -> None:
        self._minima: deque[tuple[float, float]] = deque()
        """(arrival, arrival - stamp), both ascending: candidates for the minimum of the window."""
        self._last: tuple[float, float] | None = None
        self.resets = 0
        self.untrusted = 0

    def record(self, stamp: float, arrival: float) -> None:
        """Record that a frame with presentation time ``stamp`` (seconds) arrived at ``arrival``."""
        if not math.isfinite(stamp) or stamp <= 0.0:  # the first frames of a stream have no stamp
            return

        # A jump of the stamps begins a new time base.
        if self._last is not None:
            step = stamp - self._last[0]
            elapsed = arrival - self._last[1]
            if step <= 0.0 or step > elapsed + JUMP_SECONDS:
                self._minima.clear()
                self.resets += 1
        self._last = (stamp, arrival)

        # Minimum of a sliding window: keep ascending offsets only, drop those too old.
        offset = arrival - stamp
        while self._minima and self._minima[-1][1] >= offset:
            self._minima.pop()
        self._minima.append((arrival, offset))
        while self._minima[0][0] < arrival - WINDOW_SECONDS:
            self._minima.popleft()

    def captured(self, stamp: float, arrival: float) -> float:
        """Return a frame's capture time, or its arrival if the stamp cannot be trusted.

        The frame must have been passed to `record`.
        """
        if 0.0 < stamp < math.inf and self._minima:
            captured = stamp + self._minima[0][1]
            if arrival - LAG_SECONDS_MAX <= captured <= arrival:
                return captured
        self.untrusted += 1
        return arrival
