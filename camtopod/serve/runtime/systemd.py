"""Notify systemd (sd_notify) from a service of Type=notify; do nothing where systemd is absent.

The watchdog is fed only while the program makes progress, so that systemd restarts a program that
hangs.
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
"""Longest wait for systemd to take a notification, in seconds."""
FEED_SECONDS_MAX = 1.0
"""Longest time between two watchdog notifications; a third of WatchdogSec= if that is shorter."""


def notify(*assignments: str) -> None:
    """Send assignments such as ``READY=1``, if systemd is there."""
    address = os.environ.get(SOCKET_VARIABLE, "")
    if not address:
        return
    if address.startswith("@"):  # the abstract namespace
        address = "\0" + address[1:]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as out:
        out.settimeout(SEND_SECONDS)
        try:
            out.sendto("\n".join(assignments).encode(), address)
        except OSError as error:
            log.debug("cannot notify systemd: %s", error)


def status(text: str) -> str:
    """Return the assignment that shows ``text`` in `systemctl status`."""
    return "STATUS=" + visible(" ".join(text.split()))


def reloading() -> None:
    """Announce that the configuration is being reloaded; send ``READY=1`` when it is done."""
    notify("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")


def feed_seconds() -> float:
    """Return how often to feed the watchdog of this process, in seconds."""
    value = os.environ.get("WATCHDOG_USEC", "")
    if not value.isdigit() or os.environ.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return FEED_SECONDS_MAX
    return min(FEED_SECONDS_MAX, int(value) / 3e6)


@contextmanager
def watchdog(failing: Callable[[], list[str]], starting: Callable[[], bool]) -> Iterator[None]:
    """Feed the watchdog while the block runs, unless ``failing()`` returns reasons not to.

    The reasons are logged and shown in the status when they begin and when they end. While
    ``starting()`` is true, each feeding also extends the time that the start may take.
    """
    end = threading.Event()

    def feed() -> None:
        before: list[str] = []
        while not end.is_set():
            reasons = failing()

            # Log a change, and show it in `systemctl status`.
            if reasons and not before:
                log.error("%s", "; ".join(reasons))
                notify(status("; ".join(reasons)))
            elif before and not reasons:
                log.info("all components are making progress again")
                notify(status("running"))
            before = reasons

            # Feed the watchdog.
            if not reasons:
                notify("WATCHDOG=1", *["EXTEND_TIMEOUT_USEC=30000000"] * starting())
            end.wait(feed_seconds())

    thread = threading.Thread(target=feed, name="watchdog", daemon=True)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join(SEND_SECONDS)
