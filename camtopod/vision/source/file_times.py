"""Positions of a file's frames, from stamps that are believed as far as the rate bears them out.

A recorder may put one stamp far ahead, and then count on from it by single ticks; a clock that is
set gives stamps that begin anew. On the other hand videos have true gaps, as of recorders that
write only while something moves. So a stamp that does not follow from the last ones waits for the
next five: if they go on from it at a plausible pace it was right, else the frames follow each
other at the interval of the latest ones.
"""

from __future__ import annotations

import math
from itertools import pairwise

FPS_UNKNOWN = 25.0
"""Frame rate assumed if a file has neither time stamps nor a frame rate."""
INTERVALS = 10.0
"""Step of the stamps that is believed at once, in intervals: some frames are left out.

Steps shorter than an interval by this factor are ticks. The interval is the mean over about so
many steps.
"""
CONFIRMING_FRAMES = 5
"""Frames that confirm the stamp before them."""


class FileTimes:
    """Positions of one file's frames, seconds from its beginning; they increase."""

    def __init__(self, fps: float) -> None:
        """Begin with the frame rate that the file declares, 0.0 if unknown."""
        self.interval = 1.0 / (fps or FPS_UNKNOWN)
        """Interval of the latest frames, seconds."""
        self._offset = 0.0
        """Position of a frame minus its stamp."""
        self._last_position = -self.interval
        """Position of the latest frame whose stamp is not doubted."""
        self._stamp = -math.inf
        self._doubtful_stamps: list[float] = []
        self.untrusted_count = 0
        """Number of stamps that were not believed."""

    @property
    def gap(self) -> float:
        """Longest step of the stamps that is believed at once, seconds."""
        return INTERVALS * self.interval

    @property
    def latest(self) -> float:
        """Position of the latest frame, guessed if its stamp is doubted."""
        return self._last_position + len(self._doubtful_stamps) * self.interval

    def place(self, stamp: float) -> list[float]:
        """Return the positions of this frame and of those that waited, in order.

        Empty while their stamps are doubted.
        """
        position = stamp + self._offset
        sticks = 0.0 <= stamp - self._stamp < self.interval / INTERVALS
        self._stamp = stamp
        if 0.0 < position - self.latest <= self.gap and not sticks:
            if not self._doubtful_stamps:
                step = min(position - self._last_position, 2.0 * self.interval)
                self.interval += (step - self.interval) / INTERVALS
            positions = [*self.rest(), position]
        else:
            self._doubtful_stamps.append(stamp)
            if len(self._doubtful_stamps) <= CONFIRMING_FRAMES:
                return []
            positions = self._confirmed() or self.rest()
        self._last_position = positions[-1]
        self._doubtful_stamps.clear()
        return positions

    def _confirmed(self) -> list[float]:
        """Return the positions of the doubted frames by their stamps; empty if they are wrong."""
        steps = [b - a for a, b in pairwise(self._doubtful_stamps)]
        pace = sum(steps) / len(steps)
        alike = max(steps) <= INTERVALS * min(steps)
        is_gap = max(steps) > self.gap and not alike
        if min(steps) < 0.0 or pace < self.interval / INTERVALS or is_gap:
            return []

        # A time base that begins earlier goes on from here. Positions that are a little ahead wait
        # for the stamps, as one that was believed was wrong, or the interval is not exact.
        if self._last_position - (self._doubtful_stamps[0] + self._offset) > self.gap:
            self._offset = self._last_position + self.interval - self._doubtful_stamps[0]
        if alike:
            self.interval = pace
        positions = [self._last_position]
        for stamp in self._doubtful_stamps:
            positions.append(max(positions[-1] + self.interval / INTERVALS, stamp + self._offset))
        return positions[1:]

    def rest(self) -> list[float]:
        """Return the positions of the frames that wait, by the interval of the latest ones."""
        self.untrusted_count += len(self._doubtful_stamps)
        return [
            self._last_position + n * self.interval
            for n in range(1, len(self._doubtful_stamps) + 1)
        ]
