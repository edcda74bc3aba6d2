"""Detect a second daemon of the same site.

Two daemons would both acknowledge, and each would have half of the events. So a daemon that starts
beside another one refuses to. If neither could see the other (in a network partition that has
healed), both go on and log errors until one is stopped: nothing that was acknowledged is given up.
"""

from __future__ import annotations

import logging
import threading
import time

from camtopod.serve.bus.session import Bus, BusError

log = logging.getLogger(__name__)


class OtherDaemons:
    """The other daemons of the site.

    name: the name under which the other daemons see this one.
    """

    def __init__(self, bus: Bus, name: str) -> None:
        self._bus = bus
        self.name = name
        self._rivals: set[str] = set()

    def require_none(self, seconds: float, cancel: threading.Event) -> None:
        """Raise `BusError` if there is another daemon, and it does not leave within ``seconds``."""
        deadline = time.monotonic() + seconds
        while rivals := set(self._bus.list_alive("daemon")) - {self.name}:
            if time.monotonic() >= deadline:
                raise BusError(
                    f"another daemon ({', '.join(sorted(rivals))}) serves site {self._bus.site} "
                    f"on this bus: stop it, or give one of them another [site] name"
                )
            if cancel.wait(0.1):
                return

    def appear(self) -> None:
        """Appear as a daemon of the site, and watch for others."""
        self._bus.watch_alive("daemon", self._on_change)
        self._bus.announce("daemon", self.name)

    @property
    def reason(self) -> str:
        """Reason for the degraded state; "" if this is the only daemon."""
        rivals = ", ".join(sorted(self._rivals.copy()))
        if not rivals:
            return ""
        return f"another daemon ({rivals}) serves the same site: stop one of them"

    def _on_change(self, name: str, alive: bool) -> None:
        if not alive:
            self._rivals.discard(name)
        elif name != self.name and name not in self._rivals:
            self._rivals.add(name)
            log.error("%s", self.reason)
