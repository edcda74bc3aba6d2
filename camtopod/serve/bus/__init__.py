"""bus"""

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
