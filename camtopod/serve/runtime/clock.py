"""Clocks, and identifiers made from them. The only module that reads the wall clock."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable

Clock = Callable[[], float]
"""A function that returns seconds since the Unix epoch, or since any other fixed moment."""

_CROCKFORD = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"


def wall() -> float:
    """Return the wall clock: seconds since the Unix epoch."""
    return time.time()


def since_boot() -> float:
    """Return seconds on a clock that never steps.

    Where the system has CLOCK_BOOTTIME (Linux), it also runs while the machine is suspended.
    """
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


def steady_clock_for(clock: Clock) -> Clock:
    """Return the clock to measure durations with, which never steps, given the program's ``clock``.

    A simulated clock serves for both.
    """
    return since_boot if clock is wall else clock


def ulid(now: float, after: str = "") -> str:
    """Return a ULID: 26 characters that sort by time.

    It has 48 bits of milliseconds since the epoch and 80 random bits. It sorts after the ULID
    ``after`` even if the clock has been set back since.
    """
    milliseconds = int(now * 1000)
    if after:
        milliseconds = max(
            milliseconds, 1 + sum(_CROCKFORD.index(c) << 5 * k for k, c in enumerate(after[9::-1]))
        )
    number = (milliseconds & (2**48 - 1)) << 80 | secrets.randbits(80)
    return "".join(_CROCKFORD[number >> shift & 31] for shift in range(125, -1, -5))
