"""Building blocks of a running program: clocks, liveness, counters, systemd.

Read `clock` (wall clock, steady clock, ULIDs) and `progress` (watch whether loops make progress)
first. `systemd` reports both to the service manager. `rejects` counts malformed input.
"""

from camtopod.serve.runtime import clock as clock, systemd as systemd
from camtopod.serve.runtime.clock import (
    Clock as Clock,
    steady_clock_for as steady_clock_for,
    ulid as ulid,
    wall as wall,
)
from camtopod.serve.runtime.progress import (
    LEARN_SECONDS as LEARN_SECONDS,
    STALL_SECONDS as STALL_SECONDS,
    Beat as Beat,
    Heartbeat as Heartbeat,
    Progress as Progress,
    no_beat as no_beat,
)
from camtopod.serve.runtime.rejects import Rejects as Rejects
from camtopod.serve.runtime.systemd import SOCKET_VARIABLE as SOCKET_VARIABLE
