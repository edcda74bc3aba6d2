"""Another daemon for the same site: two would both acknowledge, and each have half of the events.

One that starts beside another refuses to. Where neither could see the other (a cut between them
that heals), both go on and say so loudly until one is stopped: nothing that was acknowledged is
given up. A daemon is known by a name that stays with its state directory, so it does not mistake
its own trace from before a crash for another. The shards of a site (``2of8-NAME``) are no rivals,
as long as all are of as many.
"""

from __future__ import annotations

import logging
import re
import threading
import time

from camtopod.serve.bus.session import Bus, BusError

log = logging.getLogger(__name__)

ROLE = "daemon"
_LOOK_SECONDS = 0.1
NAMED_MAX = 20
"""Others that are remembered by name."""


class Rivals:
    """``name``: this daemon's own; ``shard``: (i, n), none for one that has the site to itself."""

    def __init__(self, bus: Bus, name: str, shard: tuple[int, int] | None = None) -> None:
        self._bus, self._shard = bus, shard
        self.name = name if shard is None else "{}of{}-{}".format(*shard, name)
        """What the others see."""
        self._there: set[str] = set()

    def refuse(self, seconds: float, cancelled: threading.Event) -> None:
        """Raises `BusError` if another is there and does not go within ``seconds``."""
        deadline = time.monotonic() + seconds
        while others := {name for name in self._bus.present(ROLE) if self._is_rival(name)}:
            if time.monotonic() >= deadline:
                raise BusError(
                    f"another daemon ({', '.join(sorted(others))}) serves site {self._bus.site} on this bus: "
                    f"stop it, or give one of them another [site] name"
                )
            if cancelled.wait(_LOOK_SECONDS):
                return

    def appear(self) -> None:
        """Be seen as the site's daemon, and look out for others."""
        self._bus.watch_alive(ROLE, self._on_change)
        self._bus.appear(ROLE, self.name)

    @property
    def reason(self) -> str:
        """Why this is no good state; empty if there is no other."""
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
