"""Positions of a file's pictures, from stamps that are believed as far as the rate bears them out.

A recorder may put one stamp far ahead, and then count on from it by single ticks; a clock that is
set gives stamps that begin anew. On the other hand videos have true gaps, as of recorders that
write only while something moves. So a stamp that does not follow from the last ones waits for the
next five: if they go on from it at a plausible pace it was right, else the pictures follow each
other at the interval of the latest ones.
"""

from __future__ import annotations

import math
from itertools import pairwise

FPS_UNKNOWN = 25.0
"""Frame rate assumed if a file has neither time stamps nor a frame rate."""
GAP_INTERVALS = 10.0
"""Step of the stamps that is believed at once, in intervals: some pictures are left out."""
CONFIRMING_PICTURES = 5
"""Pictures that confirm the stamp before them."""
STEP_SECONDS_MIN = 0.002
"""Least step of stamps that advance: pictures are farther apart, ticks are nearer."""
PACE_MIN = 0.5
"""Least pace of confirming stamps that do not all advance, in intervals of the latest pictures."""
_RATE = 0.1
"""Weight of the newest interval in their running mean."""


class FileTimes:
    """Positions of one file's pictures, seconds from its beginning; they increase."""

    def __init__(self, fps: float) -> None:
        """Begin with the frame rate that the file declares, 0.0 if unknown."""
        self.interval = 1.0 / (fps or FPS_UNKNOWN)
        """Interval of the latest pictures, seconds."""
        self._steps = 0
        self._offset = 0.0
        """Position of a picture minus its stamp."""
        self._settled = -self.interval
        """Position of the latest picture whose stamp is not doubted."""
        self._stamp = -math.inf
        self._doubted: list[float] = []
        self.untrusted = 0
        """Number of stamps that were not believed."""

    @property
    def latest(self) -> float:
        """Position of the latest picture, guessed if its stamp is doubted."""
        return self._settled + len(self._doubted) * self.interval

    def place(self, stamp: float) -> list[float]:
        """Return the positions of this picture and of those that waited, in order.

        Empty while their stamps are doubted.
        """
        position = stamp + self._offset
        gap = GAP_INTERVALS * self.interval
        sticks = 0.0 <= stamp - self._stamp < STEP_SECONDS_MIN
        self._stamp = stamp
        if 0.0 < position - self.latest <= gap and not sticks:
            if not self._doubted:
                self._learn(position - self._settled)
            positions = [*self.rest(), position]
        else:
            self._doubted.append(stamp)
            if len(self._doubted) <= CONFIRMING_PICTURES:
                return []
            positions = self._confirmed(gap) or self.rest()
        self._settled = positions[-1]
        self._doubted.clear()
        return positions

    def _confirmed(self, gap: float) -> list[float]:
        """Return the positions of the doubted pictures by their stamps; empty if they are wrong."""
        first = self._doubted[0]
        steps = [b - a for a, b in pairwise(self._doubted)]
        alike = max(steps) <= GAP_INTERVALS * min(steps)
        pace = sum(steps) / len(steps)
        if min(steps) < STEP_SECONDS_MIN and (min(steps) < 0.0 or pace < PACE_MIN * self.interval):
            return []
        if max(steps) > gap and not alike:
            return []

        # A time base that begins earlier goes on from here. Positions that are a little ahead wait
        # for the stamps, as one that was believed was wrong, or the interval is not exact.
        if self._settled - (first + self._offset) > gap:
            self._offset = self._settled + self.interval - first
        if alike:
            self.interval = pace
        positions = [self._settled]
        for stamp in self._doubted:
            least = positions[-1] + self.interval / GAP_INTERVALS
            positions.append(max(least, stamp + self._offset))
        return positions[1:]

    def rest(self) -> list[float]:
        """Return the positions of the pictures that wait, by the interval of the latest ones."""
        self.untrusted += len(self._doubted)
        return [self._settled + n * self.interval for n in range(1, len(self._doubted) + 1)]

    def _learn(self, step: float) -> None:
        """Learn the interval; the first step, to the first picture, is the declared one."""
        if self._steps:
            if self._steps > 1:
                step = min(step, 2.0 * self.interval)
            self.interval += max(_RATE, 1.0 / self._steps) * (step - self.interval)
        self._steps += 1
