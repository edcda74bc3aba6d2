"""Positions of a file's frames, from stamps that are believed as far as the rate bears them out.

A recorder may put one stamp far ahead, and then count on from it by single ticks; a clock that is
set gives stamps that begin anew. On the other hand videos have true gaps, as of recorders that
write only while something moves. So a stamp that does not follow from the last ones waits for the
next five: if they go on from it at a plausible pace it was right, else the frames follow each
other at the interval of the latest ones.

Files may stamp some frames alone: of an MPEG program stream it is the first in each packet. The
others are counted, and the next stamp tells their interval.
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
"""Frames that confirm the stamp before them, the last by its own stamp."""
WAITING_FRAMES_MAX = 60
"""Frames that wait for a stamp which confirms a doubted one, at most."""


class FileTimes:
    """Positions of one file's frames, seconds from its beginning; they increase."""

    def __init__(self, fps: float) -> None:
        """Begin with the frame rate that the file declares, 0.0 if unknown."""
        self.interval = 1.0 / (fps or FPS_UNKNOWN)
        """Interval of the latest frames, seconds."""
        self._offset = 0.0
        """Position of a frame minus its stamp."""
        self._stamped_position = -self.interval
        """Position of the latest frame whose stamp is believed, or that was settled without one."""
        self._unstamped_count = 0
        """Number of frames without a stamp that were placed since."""
        self._last_position = -self.interval
        """Position of the latest frame that was placed."""
        self._stamp = -math.inf
        self._waiting_stamps: list[float] = []
        """Stamps of the frames that wait: a doubted one and what follows, 0.0 for none."""
        self.untrusted_count = 0
        """Number of stamps that were not believed."""

    @property
    def is_unstamped(self) -> bool:
        """True if no frame has a stamp, so that all positions follow from the declared rate."""
        return self._stamp == 0.0 and self._unstamped_count > 0

    @property
    def gap(self) -> float:
        """Longest step of the stamps that is believed at once, seconds."""
        return INTERVALS * self.interval

    @property
    def latest(self) -> float:
        """Position of the latest frame, guessed if its stamp is doubted."""
        return self._last_position + len(self._waiting_stamps) * self.interval

    def place(self, stamp: float) -> list[float]:
        """Return the positions of this frame and of those that waited, in order.

        Empty while their stamps are doubted. The stamp is 0.0 if the frame has none.
        """
        if stamp == 0.0 and self._stamp > -math.inf:
            return self._place_unstamped()
        position = stamp + self._offset
        sticks = 0.0 <= stamp - self._stamp < self.interval / INTERVALS
        self._stamp = stamp

        # The step from the last believed stamp, over all frames since, is believed or doubted.
        waiting_count = len(self._waiting_stamps)
        pace = (position - self._stamped_position) / (self._unstamped_count + waiting_count + 1)
        seconds_max = self.gap + (2 * self._unstamped_count + waiting_count) * self.interval
        is_near = position - self._stamped_position <= seconds_max
        if pace > self.interval / INTERVALS and is_near and not sticks:
            if not waiting_count:
                share = min(1.0, (self._unstamped_count + 1) / INTERVALS)
                self.interval += (min(pace, 2.0 * self.interval) - self.interval) * share
            self._count_untrusted()
            return self._settled(self._spread(position), position)
        self._waiting_stamps.append(stamp)
        if waiting_count < CONFIRMING_FRAMES:
            return []
        if positions := self._confirmed():
            return self._settled(positions, stamp + self._offset)
        return self._guessed()

    def _place_unstamped(self) -> list[float]:
        """Return the positions of a frame without a stamp and of those that waited."""
        if self._waiting_stamps:
            self._waiting_stamps.append(0.0)
            return self._guessed() if len(self._waiting_stamps) > WAITING_FRAMES_MAX else []
        self._unstamped_count += 1
        position = self._stamped_position + self._unstamped_count * self.interval
        self._last_position = max(position, self._last_position + self.interval / INTERVALS)
        return [self._last_position]

    def _guessed(self) -> list[float]:
        """Return the positions of the frames that waited, without their stamps."""
        positions = self.rest()
        return self._settled(positions, positions[-1])

    def _settled(self, positions: list[float], stamped_position: float) -> list[float]:
        """Return the positions; those that follow count from ``stamped_position``."""
        self._last_position = positions[-1]
        self._stamped_position = stamped_position
        self._unstamped_count = 0
        self._waiting_stamps.clear()
        return positions

    def _spread(self, position: float) -> list[float]:
        """Return positions of the frames that wait, and of the one after them, up to this one."""
        count = len(self._waiting_stamps) + 1
        step = (position - self._last_position) / count
        step = max(step, self.interval / INTERVALS)
        return [self._last_position + n * step for n in range(1, count + 1)]

    def _confirmed(self) -> list[float]:
        """Return the positions of the waiting frames by their stamps; empty if they are wrong."""
        stamps = [(number, stamp) for number, stamp in enumerate(self._waiting_stamps) if stamp]
        paces = [(t2 - t1) / (n2 - n1) for (n1, t1), (n2, t2) in pairwise(stamps)]
        pace = (stamps[-1][1] - stamps[0][1]) / (stamps[-1][0] - stamps[0][0])
        alike = max(paces) <= INTERVALS * min(paces)
        is_gap = max(paces) > self.gap and not alike
        if min(paces) < 0.0 or pace < self.interval / INTERVALS or is_gap:
            return []

        # A time base that begins earlier goes on from here. Positions that are a little ahead wait
        # for the stamps, as one that was believed was wrong, or the interval is not exact.
        if self._last_position - (stamps[0][1] + self._offset) > self.gap:
            self._offset = self._last_position + self.interval - stamps[0][1]
        if alike:
            self.interval = pace
        positions = [self._last_position]
        for stamp in self._waiting_stamps:
            position = stamp + self._offset if stamp else positions[-1] + self.interval
            positions.append(max(positions[-1] + self.interval / INTERVALS, position))
        return positions[1:]

    def _count_untrusted(self) -> None:
        """Count the stamps that wait as not believed."""
        self.untrusted_count += sum(stamp != 0.0 for stamp in self._waiting_stamps)

    def rest(self) -> list[float]:
        """Return the positions of the frames that wait, by the interval of the latest ones."""
        self._count_untrusted()
        return [
            self._last_position + n * self.interval for n in range(1, len(self._waiting_stamps) + 1)
        ]
