"""Detect a second daemon of the same site.

Two daemons would both acknowledge, and each would have half of the events. So a daemon that starts
beside another one refuses to. If neither could see the other (in a network partition that has
healed), both go on and log errors until one is stopped: nothing that was acknowledged is given up.
A daemon's name stays with its state directory, so it does not mistake its own traces from before a
crash for another daemon. The shards of a site (``2of8-NAME``) are no rivals as long as all of them
state the same number of shards.
"""

from __future__ import annotations

import logging
import re
import threading
import time

from camtopod.serve.bus.session import Bus, BusError

log = logging.getLogger(__name__)

ROLE = "daemon"
"""Role under which daemons appear on the bus, see `Bus.announce`."""
_LOOK_SECONDS = 0.1
"""Time between two looks for other daemons at the start, in seconds."""
NAMED_MAX = 20
"""Most other daemons that are remembered by name."""


class OtherDaemons:
    """The other daemons of the site.

    name: the name of this daemon.
    shard: (i, n) for shard i of n; None for a daemon that serves its site alone.
    """

    def __init__(self, bus: Bus, name: str, shard: tuple[int, int] | None = None) -> None:
        self._bus, self._shard = bus, shard
        self.name = name if shard is None else "{}of{}-{}".format(*shard, name)
        """The name under which the other daemons see this one."""
        self._there: set[str] = set()

    def require_none(self, seconds: float, cancelled: threading.Event) -> None:
        """Raise `BusError` if there is another daemon, and it does not leave within ``seconds``."""
        deadline = time.monotonic() + seconds
        while others := {name for name in self._bus.list_alive(ROLE) if self._is_rival(name)}:
            if time.monotonic() >= deadline:
                raise BusError(
                    f"another daemon ({', '.join(sorted(others))}) serves site {self._bus.site} "
                    f"on this bus: stop it, or give one of them another [site] name"
                )
            if cancelled.wait(_LOOK_SECONDS):
                return

    def appear(self) -> None:
        """Appear as a daemon of the site, and watch for others."""
        self._bus.watch_alive(ROLE, self._on_change)
        self._bus.announce(ROLE, self.name)

    @property
    def reason(self) -> str:
        """Reason for the degraded state; "" if this is the only daemon."""
        others = ", ".join(sorted(self._there.copy()))
        return f"another daemon ({others}) serves the same site: stop one of them" if others else ""

    def _on_change(self, name: str, alive: bool) -> None:
        if not self._is_rival(name):
            return
        if not alive:
            self._there.discard(name)
        elif name not in self._there and len(self._there) < NAMED_MAX:
            self._there.add(name)
            log.error(
                "another daemon (%s) serves site %s on this bus: stop one of them",
                name,
                self._bus.site,
            )

    def _is_rival(self, name: str) -> bool:
        if name == self.name:
            return False
        theirs = re.match("([0-9]{1,9})of([0-9]{1,9})-", name)
        if self._shard is None or theirs is None:
            return True
        number, shards = int(theirs[1]), int(theirs[2])
        return shards != self._shard[1] or number == self._shard[0]
