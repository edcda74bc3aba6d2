"""The daemon around the learner, and everything that can fail: bus, journal, clock, processes.

Read `daemon` first; it starts and connects the parts. `ingest` brings events into order and into
the journal; `storage` is the journal; `learner_process` runs the learner; `live_predictions`
answers exits; `bus` is the session with zenoh; `outbox` is the grabber's side; `runtime` holds
clocks and progress. `recorded_state` makes a state directory of a recording.
`admin_queries` are an operator's commands on the bus, and `offline_commands` carries them out
without a daemon.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.serve.admin_queries import Done, parameters_of
    from camtopod.serve.daemon import Daemon
    from camtopod.serve.offline_commands import carry_out_offline
    from camtopod.serve.recorded_state import RecordedState

__all__ = [
    "Daemon",
    "Done",
    "RecordedState",
    "carry_out_offline",
    "parameters_of",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "Daemon": "daemon",
        "Done": "admin_queries",
        "RecordedState": "recorded_state",
        "carry_out_offline": "offline_commands",
        "parameters_of": "admin_queries",
    },
)
