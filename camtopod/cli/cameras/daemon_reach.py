"""Log lines about the connection of a machine's cameras to the daemon, once for all cameras.

Each camera has a connection of its own, and they are lost and restored at different moments.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping

log = logging.getLogger(__name__)

SETTLE_SECONDS = 1.0
"""Time that a state of all cameras must last before it is logged."""
PARTIAL_SECONDS = 15.0
"""Time that a state of only some cameras must last before it is logged.

Connections are restored within a few seconds of each other.
"""
NAMED_MAX = 10
"""Most cameras named in a log line."""
_ALL = frozenset({"*"})
"""Stands for all cameras."""


class DaemonReachLog:
    """Logs changes in whether the cameras reach the daemon; times are monotonic seconds."""

    def __init__(self) -> None:
        self._now: frozenset[str] = frozenset()
        """Cameras that do not reach the daemon, or `_ALL`."""
        self._since = 0.0
        self._said: frozenset[str] = frozenset()

    def tell(self, known: Mapping[str, str], now: float) -> None:
        """Update with the cameras whose connection is known, and log a change that has lasted.

        known: camera -> why it does not reach the daemon, "" if it does.
        """
        away = {camera: why for camera, why in known.items() if why}
        if not known:
            return
        found = _ALL if len(away) == len(known) else frozenset(away)
        if found != self._now:
            self._now, self._since = found, now

        # Log it once it has lasted.
        partial = found not in (_ALL, frozenset())
        if found == self._said or now - self._since < (
            PARTIAL_SECONDS if partial else SETTLE_SECONDS
        ):
            return

        self._said = found
        if not away:
            log.info("connected to the daemon again")
        elif not partial:
            log.warning(
                "%s; events are kept in the spools of all cameras", next(iter(away.values()))
            )
        else:
            names = ", ".join(sorted(away)[:NAMED_MAX]) + (
                " and others" if len(away) > NAMED_MAX else ""
            )
            log.warning(
                "%s of %d cameras do not reach the daemon: %s (%s)",
                len(away),
                len(known),
                names,
                next(iter(away.values())),
            )
