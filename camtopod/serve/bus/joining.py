"""Joining the bus: as a client of the meeting point, or as the daemon, which may be that point."""

from __future__ import annotations

import logging
import socket
import time

from camtopod.config import Config
from camtopod.serve.bus import access
from camtopod.serve.bus.access import BusError
from camtopod.serve.bus.session import Bus, NotOpened, open_session
from camtopod.serve.runtime import clock

log = logging.getLogger(__name__)


def dial(config: Config) -> Bus:
    """Open a client session, trying for ``bus.connect_seconds``. Raises `BusError`."""
    endpoints = config.dials
    access.check_files(config)

    # Retry until the deadline.
    deadline = time.monotonic() + config.bus.connect_seconds
    while True:
        try:
            return open_session(config, access.settings(config, "client"), connect=endpoints)
        except NotOpened as error:
            if time.monotonic() >= deadline:
                place = f"cannot reach the bus at {', '.join(endpoints)}"
                if ended := access.ended_certificate(config):
                    raise BusError(place + ended) from None
                also = ", and does it accept this certificate" if config.bus.tls.ca else ""
                raise BusError(
                    f"{place}: is `camtopod run` running there{also}? ({error})"
                ) from None
            time.sleep(0.2)


def open_daemon_session(config: Config) -> Bus:
    """Open the daemon's session: listen at ``config.listens``, or connect if there are none.

    Port 0 stands for a free port. Logs a warning if the bus is open without authentication. Raises
    `BusError`.
    """
    if (open_to := access.openness_warning(config)) is not None:
        log.warning("%s", open_to)

    if not config.listens:
        return dial(config)

    # Listen.
    endpoints = [_with_port(endpoint) for endpoint in config.listens]
    access.check_files(config)
    values = access.settings(config, "router", access.read_access(config, clock.wall))
    try:
        bus = open_session(config, values, connect=config.peers, listen=endpoints)
    except NotOpened as error:
        raise BusError(
            f"cannot listen at {', '.join(endpoints)}: another daemon may be running there; "
            f"stop it or set other endpoints in [bus] ({error})"
        ) from None

    # Keep stalled connections from delaying others when they are closed.
    bus.watch_connections()
    return bus


def _with_port(endpoint: str) -> str:
    """Replace port 0 of ``tcp/host:0`` by a port that is free now.

    Zenoh accepts port 0 but does not tell which port it got.
    """
    if not endpoint.endswith(":0"):
        return endpoint
    host = endpoint.split("/", 1)[1].removesuffix(":0")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.bind((host.strip("[]"), 0))
        return f"{endpoint.removesuffix('0')}{probe.getsockname()[1]}"
