"""The only place that reads the wall clock, and the ids made from it."""

from __future__ import annotations

import contextlib
import secrets
import socket
import time
from collections.abc import Callable
from pathlib import Path

Clock = Callable[[], float]
"""Seconds since the Unix epoch, or since whenever."""

_CROCKFORD = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"


def wall() -> float:
    """Seconds since the Unix epoch, now."""
    return time.time()


def since_boot() -> float:
    """Seconds that never step and do not stand still while the machine is suspended, where the
    system tells those.
    """
    return (
        time.clock_gettime(time.CLOCK_BOOTTIME)
        if hasattr(time, "CLOCK_BOOTTIME")
        else time.monotonic()
    )


def box() -> str:
    """What is the same in all programs that read this machine's clock, and in no others: this boot
    of its kernel.
    """
    with contextlib.suppress(OSError):
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    return socket.gethostname()


def steady_beside(clock: Clock) -> Clock:
    """The clock that measures how long something takes: it never steps. Whoever makes up the time
    (a simulation) makes it up for both.
    """
    return since_boot if clock is wall else clock


def ulid(now: float, after: str = "") -> str:
    """A ULID: 26 characters, 48 bits of milliseconds since the epoch and 80 random bits, sorted by
    time.

    It sorts behind the ULID ``after`` even if the clock has been set back since.
    """
    milliseconds = int(now * 1000)
    if after:
        milliseconds = max(
            milliseconds, 1 + sum(_CROCKFORD.index(c) << 5 * k for k, c in enumerate(after[9::-1]))
        )
    number = (milliseconds & (2**48 - 1)) << 80 | secrets.randbits(80)
    return "".join(_CROCKFORD[number >> shift & 31] for shift in range(125, -1, -5))
