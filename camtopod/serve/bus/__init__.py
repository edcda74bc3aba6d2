"""The bus: publish, subscribe and query between the programs of a site, over zenoh.

Start with `session`: `Bus`, one program's session, opened by `dial` (a client) or `meet` (the
daemon, which other programs connect to). `topology_subscriber` follows the daemon's topology. The
other modules serve the daemon: `access` (who may connect), `refusals` (count what zenoh refuses,
from its log), `sockets` (options that zenoh does not set), `single_daemon` (detect a second daemon
of the site) and `self_check` (is the bus reachable).
"""

from __future__ import annotations

from camtopod.serve.bus import access, session
from camtopod.serve.bus.access import boxes
from camtopod.serve.bus.self_check import SelfCheck
from camtopod.serve.bus.session import (
    HANGS_SECONDS,
    JSON,
    Bus,
    BusError,
    Ear,
    Heard,
    OnMessage,
    QueryError,
    dial,
    meet,
    refusals_heard,
)
from camtopod.serve.bus.single_daemon import ROLE, Rivals
from camtopod.serve.bus.topology_subscriber import TopologyView

__all__ = [
    "HANGS_SECONDS",
    "JSON",
    "ROLE",
    "Bus",
    "BusError",
    "Ear",
    "Heard",
    "OnMessage",
    "QueryError",
    "Rivals",
    "SelfCheck",
    "TopologyView",
    "access",
    "boxes",
    "dial",
    "meet",
    "refusals_heard",
    "session",
]
