"""Capture times of frames, from presentation stamps as far as arrivals bear them out.

Frames arrive late, never early. Over one connection the smallest difference (arrival - stamp) is
therefore the best estimate of the offset between the source's time base and ours; any excess is
delay. The minimum is taken over the last half minute, so that it forgets the burst of old frames
after opening.

Delay passes: some frame of any few bursts is prompt. Where none has been lately, the stamps run at
a wrong rate, stick, or lost time, and arrivals are used instead. Stamps that run fast need no rule:
each frame has the smallest difference so far, so that its capture time is its arrival.
"""

from __future__ import annotations

import math
from collections import deque

WINDOW_SECONDS = 30.0
"""Length of the window of the minimum."""
JUMP_SECONDS = 5.0
"""Jump of stamps that starts a new time base: backwards, or forwards by this more than arrivals."""
LAG_SECONDS_MAX = 15.0
"""Longest plausible delay of a frame, that of a segment of HLS; more is not trusted."""
PROMPT_SECONDS = 0.3
"""Delay of a prompt frame at most, unless frames come in bursts with longer gaps: then the gap.

It is what a busy network adds to the promptest of several frames, and the delay by which segments
that are asked for now and then come later. Over the window, stamps whose rate is more than one in a
hundred too slow exceed it.
"""
PROMPT_WITHIN_SECONDS = 1.0
"""Time within which some frame is prompt, unless frames come in bursts with longer gaps."""
PROMPT_WITHIN_GAPS = 2.0
"""The same in gaps between bursts: so that it holds the end of one."""


class StampClock:
    """Capture times of one connection, on the clock of the arrivals (seconds; monotonic)."""

    def __init__(self) -> None:
        self._minima: deque[tuple[float, float]] = deque()
        """(arrival, arrival - stamp), both ascending: candidates for the minimum of the window."""
        self._last: tuple[float, float] | None = None
        self._first: tuple[float, float] | None = None
        """Stamp and arrival of the first frame of the time base, as `_last` of the latest."""
        self._gap = 0.0
        """Longest time between two arrivals, which fades over the window."""

    def record(self, stamp: float, arrival: float) -> None:
        """Record that a frame with presentation time ``stamp`` (seconds) arrived at ``arrival``."""
        if not math.isfinite(stamp) or stamp <= 0.0:  # the first frames of a stream have no stamp
            return

        # A jump of the stamps begins a new time base.
        if self._last is not None:
            step = stamp - self._last[0]
            elapsed = arrival - self._last[1]
            self._gap = max(elapsed, self._gap * (1.0 - elapsed / WINDOW_SECONDS))
            if step <= 0.0 or step > elapsed + JUMP_SECONDS:
                self._minima.clear()
                self._first = None
        self._last = (stamp, arrival)
        self._first = self._first or self._last

        # Minimum of a sliding window: keep ascending offsets only, drop those too old.
        offset = arrival - stamp
        while self._minima and self._minima[-1][1] >= offset:
            self._minima.pop()
        self._minima.append((arrival, offset))
        while self._minima[0][0] < arrival - WINDOW_SECONDS:
            self._minima.popleft()

    def captured(self, stamp: float, arrival: float) -> float | None:
        """Return a frame's capture time; None if its stamp cannot be trusted.

        The frame must have been passed to `record`. One without a stamp (0.0), as after a pause,
        counts as captured when the last one was.
        """
        if stamp == 0.0 and self._last is not None:
            last, at = self._last
            stamp = last if 0.0 <= arrival - at <= self._burst_seconds else 0.0
        if 0.0 < stamp < math.inf and self._minima:
            captured = stamp + self._minima[0][1]
            if self._borne_out and arrival - LAG_SECONDS_MAX <= captured <= arrival:
                return captured
        return None

    @property
    def outran(self) -> bool:
        """True if stamps cover more than twice the time of the arrivals: they are not live."""
        if self._first is None or self._last is None:
            return False
        return self._last[0] - self._first[0] > 2.0 * (self._last[1] - self._first[1])

    @property
    def _borne_out(self) -> bool:
        """True if some frame has been prompt lately."""
        newest, _ = self._minima[-1]
        since = newest - self._burst_seconds
        lately = next(offset for arrival, offset in self._minima if arrival >= since)
        return lately - self._minima[0][1] <= max(PROMPT_SECONDS, self._gap)

    @property
    def _burst_seconds(self) -> float:
        """Time within which some frame is prompt."""
        return max(PROMPT_WITHIN_SECONDS, PROMPT_WITHIN_GAPS * self._gap)
