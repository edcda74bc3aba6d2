"""What systemd is told (sd_notify) by a service of Type=notify; nothing happens where there is no
systemd.

The watchdog is fed only while the program gets on, so that systemd starts again what hangs.
"""

from __future__ import annotations

import logging
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from camtopod.visible import visible

log = logging.getLogger(__name__)

SOCKET_VARIABLE = "NOTIFY_SOCKET"
SEND_SECONDS = 1.0
FEED_SECONDS_MAX = 1.0
"""Between two feedings, at most; and a third of what the unit's WatchdogSec= allows."""
EXTEND_MICROSECONDS = 30_000_000
"""A start that gets on may take this much longer from now."""


def notify(*assignments: str) -> bool:
    """Send e.g. ``READY=1``, ``STATUS=...``; whether systemd is there and took it."""
    address = os.environ.get(SOCKET_VARIABLE, "")
    if not address:
        return False
    if address.startswith("@"):  # the abstract namespace
        address = "\0" + address[1:]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as out:
        out.settimeout(SEND_SECONDS)
        try:
            out.sendto("\n".join(assignments).encode(), address)
        except OSError as error:
            log.debug("systemd cannot be told: %s", error)
            return False
    return True


def status(text: str) -> str:
    """The assignment that shows ``text`` in `systemctl status`."""
    return "STATUS=" + visible(" ".join(text.split()))


def reloading() -> None:
    """The configuration is being read anew; say ``READY=1`` when that is done."""
    notify("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")


def feed_seconds() -> float:
    """How often to feed the watchdog of this process."""
    given = os.environ.get("WATCHDOG_USEC", "")
    if not given.isdigit() or os.environ.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return FEED_SECONDS_MAX
    return min(FEED_SECONDS_MAX, int(given) / 3e6)


@contextmanager
def watchdog(failing: Callable[[], list[str]], starting: Callable[[], bool]) -> Iterator[None]:
    """While the block runs feed the watchdog, unless ``failing()`` says why not; log when that
    changes.

    While ``starting()`` the start may take longer, too, as long as it gets on.
    """
    done = threading.Event()

    def feed() -> None:
        before: list[str] = []
        while not done.is_set():
            reasons = failing()
            if reasons and not before:
                log.error("%s", "; ".join(reasons))
                notify(status("; ".join(reasons)))
            elif before and not reasons:
                log.info("all parts get on again")
                notify(status("running"))
            before = reasons
            if not reasons:
                extend = [f"EXTEND_TIMEOUT_USEC={EXTEND_MICROSECONDS}"] if starting() else []
                notify("WATCHDOG=1", *extend)
            done.wait(feed_seconds())

    thread = threading.Thread(target=feed, name="watchdog", daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join(SEND_SECONDS)
