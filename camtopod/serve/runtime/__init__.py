"""Building blocks of a running program: clocks, liveness, counters, systemd.

Read `clock` (wall clock, steady clock, ULIDs) and `progress` (watch whether loops make progress)
first. `systemd` reports both to the service manager. `rejects` counts malformed input, and `reload`
compares configurations.
"""

from __future__ import annotations

from camtopod.serve.runtime import clock, systemd
from camtopod.serve.runtime.clock import Clock, steady_clock_for, ulid, wall
from camtopod.serve.runtime.progress import Beat, Heartbeat, Progress, no_beat
from camtopod.serve.runtime.rejects import Rejects
from camtopod.serve.runtime.reload import changed_settings
from camtopod.serve.runtime.systemd import SOCKET_VARIABLE

__all__ = [
    "SOCKET_VARIABLE",
    "Beat",
    "Clock",
    "Heartbeat",
    "Progress",
    "Rejects",
    "changed_settings",
    "clock",
    "no_beat",
    "steady_clock_for",
    "systemd",
    "ulid",
    "wall",
]
