"""Whether the bus still lives at which this daemon is the meeting point: it is a client of its own,
and looks for itself there as any other program would.

What it publishes and answers does not tell: a session hands that to itself without a connection.
"""

from __future__ import annotations

import contextlib
import logging
import threading

import msgspec

from camtopod.config import Config
from camtopod.serve.bus.session import Bus, BusError, dial
from camtopod.serve.bus.single_daemon import ROLE
from camtopod.serve.runtime import Mark

log = logging.getLogger(__name__)

LOOK_SECONDS = 5.0


class SelfCheck:
    """``endpoint``: where the daemon listens; ``name``: what it is known by there."""

    def __init__(self, config: Config, endpoint: str, name: str) -> None:
        bus = msgspec.structs.replace(config.bus, listen=(endpoint,), connect=())
        self._config, self._name = msgspec.structs.replace(config, bus=bus), name
        self._reached = False
        self.look_seconds_max = LOOK_SECONDS + config.bus.connect_seconds + config.bus.query_seconds
        """Between two looks, at most."""

    def work(self, stopping: threading.Event, mark: Mark) -> None:
        """Look every `LOOK_SECONDS`; once it has been seen, ``mark`` beats only when it is seen."""
        with contextlib.ExitStack() as stack:
            session: Bus | None = None
            while not stopping.wait(LOOK_SECONDS):
                if session is None and (session := self._dial()) is not None:
                    stack.callback(session.close)
                seen = session is not None and self._name in session.present(ROLE)
                self._reached = self._reached or seen
                if seen or not self._reached:
                    mark.beat()

    def _dial(self) -> Bus | None:
        """None where it is not reached from here: a firewall, an interface or a certificate may be
        the reason.
        """
        try:
            return dial(self._config)
        except BusError as error:
            log.debug("the daemon does not reach itself: %s", error)
            return None
