"""The bus: publish, subscribe and query between the programs of a site, over zenoh.

Start with `session`: `Bus`, one program's session, opened by `dial` (a client) or
`open_daemon_session` (the daemon, which other programs connect to). `topology_subscriber` follows
the daemon's topology, and `site_choice` finds the site where none was named. The other modules
serve the daemon: `access` (who may connect), `refusals` (count what zenoh refuses, from its log),
`sockets` (options that zenoh does not set), `single_daemon` (detect a second daemon of the site)
and `self_check` (is the bus reachable).
"""

from __future__ import annotations

from camtopod.serve.bus import access, session
from camtopod.serve.bus.access import certificate_by_camera
from camtopod.serve.bus.self_check import SelfCheck
from camtopod.serve.bus.session import (
    JSON,
    SLOW_PUBLICATION_SECONDS,
    Bus,
    BusError,
    Heard,
    OnMessage,
    QueryError,
    Subscription,
    counting_refusals,
    dial,
    open_daemon_session,
)
from camtopod.serve.bus.single_daemon import ROLE, OtherDaemons
from camtopod.serve.bus.site_choice import sites_instead, take_only_site
from camtopod.serve.bus.topology_subscriber import TopologySubscriber

__all__ = [
    "JSON",
    "ROLE",
    "SLOW_PUBLICATION_SECONDS",
    "Bus",
    "BusError",
    "Heard",
    "OnMessage",
    "OtherDaemons",
    "QueryError",
    "SelfCheck",
    "Subscription",
    "TopologySubscriber",
    "access",
    "certificate_by_camera",
    "counting_refusals",
    "dial",
    "open_daemon_session",
    "session",
    "sites_instead",
    "take_only_site",
]
