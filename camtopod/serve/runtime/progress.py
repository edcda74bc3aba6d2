"""Liveness: detect loops of a program that have stalled, although the process is running.

A loop calls `Heartbeat.beat` after each piece of work, and when it finds no work. A loop that hangs
in a single step, or has work waiting and cannot do it, does not beat; after its time limit it
counts as stalled. A loop that waits for something that is monitored elsewhere (a full disk, room in
the learner's queue) beats all the same, as a restart would not help.
"""

from __future__ import annotations

import time
from collections.abc import Callable

STALL_SECONDS = 30.0
"""A loop without progress for this long makes its program unhealthy, and systemd restarts it."""
LEARN_SECONDS = 900.0
"""The same for a step of the learner (a refit takes long on a small machine) and for the start."""
Beat = Callable[[], None]
"""A function that a loop calls when it makes progress. Cheap, thread-safe, never blocks."""


def no_beat() -> None:
    """Do nothing: the beat of a loop that is not watched."""


class Heartbeat:
    """When one loop last made progress, on the monotonic clock."""

    def __init__(self, seconds_max: float) -> None:
        self.seconds_max = seconds_max
        self.last = time.monotonic()

    def beat(self) -> None:
        """Record that the loop makes progress now."""
        self.last = time.monotonic()


class Progress:
    """The marks of all watched loops of a program. Thread-safe."""

    def __init__(self) -> None:
        self._marks: dict[str, Heartbeat] = {}

    def watch(self, name: str, seconds_max: float) -> Heartbeat:
        """Return a new mark for the loop ``name``, which may be silent for ``seconds_max``."""
        mark = self._marks[name] = Heartbeat(seconds_max)
        return mark

    def unwatch(self, name: str) -> None:
        """Stop watching a loop, which has ended as it should. May be called twice."""
        self._marks.pop(name, None)

    def stalled(self) -> list[str]:
        """Return a sentence for each loop over its time limit; empty if all make progress."""
        now = time.monotonic()
        return [
            f"{name} has made no progress for {now - mark.last:.0f} s"
            f" (limit: {mark.seconds_max:g} s)"
            for name, mark in sorted(self._marks.copy().items())
            if now - mark.last > mark.seconds_max
        ]
