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
"""Length of the window of the minimum, and so the longest plausible delay.

Stamps that go back, or get ahead of the arrivals by so much, begin a new time base.
"""
PROMPT_SECONDS = 0.3
"""Delay of a prompt frame at most, unless frames come in bursts with longer gaps: then the gap.

It is what a busy network adds to the promptest of several frames, and the delay by which segments
that are asked for now and then come later. Over the window, stamps whose rate is more than one in a
hundred too slow exceed it. Within twice that time some frame is prompt.
"""


class StampClock:
    """Capture times of one connection, on the clock of the arrivals (seconds; monotonic)."""

    def __init__(self) -> None:
        self._minima: deque[tuple[float, float]] = deque()
        """(arrival, arrival - stamp), both ascending: candidates for the minimum of the window."""
        self._first = self._last = (math.nan, math.nan)
        """Stamp and arrival of the first frame of the time base, and of the latest; NaN: none."""
        self._delay_max = PROMPT_SECONDS
        """Delay of a prompt frame at most, seconds; the longest gap fades over the window."""

    def record(self, stamp: float, arrival: float) -> None:
        """Record that a frame with presentation time ``stamp`` (seconds) arrived at ``arrival``."""
        if not math.isfinite(stamp) or stamp <= 0.0:  # the first frames of a stream have no stamp
            return

        # A jump of the stamps begins a new time base, and so does the first (no comparison holds).
        step = stamp - self._last[0]
        elapsed = arrival - self._last[1]
        self._last = (stamp, arrival)
        if not 0.0 < step <= elapsed + WINDOW_SECONDS:
            self._minima.clear()
            self._first = self._last
        old_delay = self._delay_max * (1.0 - elapsed / WINDOW_SECONDS)
        self._delay_max = max(PROMPT_SECONDS, elapsed, old_delay)

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
        if stamp == 0.0 and 0.0 <= arrival - self._last[1] <= 2.0 * self._delay_max:
            stamp = self._last[0]
        if not 0.0 < stamp < math.inf or not self._minima:
            return None
        since = self._minima[-1][0] - 2.0 * self._delay_max
        lately = next(offset for at, offset in self._minima if at >= since)
        capture_t = stamp + self._minima[0][1]
        is_prompt = lately - self._minima[0][1] <= self._delay_max
        return capture_t if is_prompt and -WINDOW_SECONDS <= capture_t - arrival <= 0.0 else None

    @property
    def outran(self) -> bool:
        """True if stamps cover more than twice the time of the arrivals: they are not live."""
        return self._last[0] - self._first[0] > 2.0 * (self._last[1] - self._first[1])
