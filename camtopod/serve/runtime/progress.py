"""Whether the loops of a program get on. Healthy means making progress, not being alive.

A loop beats when it has done something or has found nothing to do. One that hangs in a single step,
or has work waiting and cannot do it, does not beat, and after its limit it is stuck. What is waited
for elsewhere and known there (a full disk, the learner's room) is no reason not to beat: starting
again would not help.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

Beat = Callable[[], None]
"""Called by a loop that gets on; cheap, from any thread, never blocks."""


def no_beat() -> None:
    """For a loop whose progress nobody watches."""


class Mark:
    """When one loop last got on, on the monotonic clock."""

    def __init__(self, seconds_max: float, monotonic: Callable[[], float]) -> None:
        self.seconds_max = seconds_max
        self._monotonic = monotonic
        self._last = monotonic()

    def beat(self) -> None:
        """It gets on."""
        self._last = self._monotonic()

    def beat_as_of(self, since: float) -> None:
        """What it waits for has been going on since ``since``, on the monotonic clock."""
        self._last = max(self._last, min(since, self._monotonic()))

    def silent(self) -> float:
        """Seconds since it last got on."""
        return self._monotonic() - self._last


class Progress:
    """The marks of all loops of a program; a loop that has none is not watched. Thread-safe."""

    def __init__(self, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._monotonic = monotonic
        self._mutex = threading.Lock()
        self._marks: dict[str, Mark] = {}

    def watch(self, name: str, seconds_max: float) -> Mark:
        """From now on ``name`` has to beat at least every ``seconds_max``."""
        mark = Mark(seconds_max, self._monotonic)
        with self._mutex:
            self._marks[name] = mark
        return mark

    def allow(self, name: str, seconds_max: float) -> None:
        """Another limit for what is watched already."""
        with self._mutex:
            self._marks[name].seconds_max = seconds_max

    def forget(self, name: str) -> None:
        """It has ended, as it should; may be said twice."""
        with self._mutex:
            self._marks.pop(name, None)

    def stuck(self) -> list[str]:
        """For each loop over its limit a sentence for a person; empty if all get on."""
        with self._mutex:
            silent = {name: (mark.silent(), mark.seconds_max) for name, mark in self._marks.items()}
        return [
            f"{name} has not got on for {math.floor(seconds)} s (allowed: {most:g} s)"
            for name, (seconds, most) in sorted(silent.items())
            if seconds > most
        ]
