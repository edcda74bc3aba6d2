"""Check that the bus a daemon listens on is alive, by connecting to it as a client.

The daemon looks for itself on the bus as any other program would. Its own session cannot tell:
zenoh delivers a session's publications and answers to the session itself without a connection.
"""

from __future__ import annotations

import contextlib
import logging
import threading

import msgspec

from camtopod.config import Config
from camtopod.serve.bus.session import Bus, BusError, dial
from camtopod.serve.bus.single_daemon import ROLE
from camtopod.serve.runtime import Heartbeat

log = logging.getLogger(__name__)

CHECK_SECONDS = 5.0
"""Time between two checks, in seconds."""


class SelfCheck:
    """The check of one daemon's bus.

    endpoint: the endpoint at which the daemon listens.
    name: the name under which it appears on the bus.
    """

    def __init__(self, config: Config, endpoint: str, name: str) -> None:
        bus = msgspec.structs.replace(config.bus, listen=(endpoint,), connect=())
        self._config, self._name = msgspec.structs.replace(config, bus=bus), name
        self._reached = False
        self.look_seconds_max = (
            CHECK_SECONDS + config.bus.connect_seconds + config.bus.query_seconds
        )
        """Longest time between two checks, in seconds."""

    def work(self, stopping: threading.Event, mark: Heartbeat) -> None:
        """Check every `CHECK_SECONDS` until ``stopping`` is set, and beat ``mark`` after a success.

        Until the first success ``mark`` beats, too: the daemon may be unreachable from its own
        machine.
        """
        with contextlib.ExitStack() as stack:
            session: Bus | None = None
            while not stopping.wait(CHECK_SECONDS):
                if session is None and (session := self._dial()) is not None:
                    stack.callback(session.close)
                seen = session is not None and self._name in session.list_alive(ROLE)
                self._reached = self._reached or seen
                if seen or not self._reached:
                    mark.beat()

    def _dial(self) -> Bus | None:
        """Return a client session; None if the bus cannot be reached from here.

        The reason may be a firewall, a network interface or a certificate.
        """
        try:
            return dial(self._config)
        except BusError as error:
            log.debug("the daemon cannot reach its own bus: %s", error)
            return None
