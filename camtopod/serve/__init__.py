"""The daemon around the learner, and everything that can fail: bus, journal, clock, processes.

Read `daemon` first; it starts and connects the parts. `ingest` brings events into order and into
the journal; `storage` is the journal; `learner_process` runs the learner; `live_predictions`
answers exits; `shards` joins the daemons of a large site; `bus` is the session with zenoh; `outbox`
is the grabber's side; `runtime` holds clocks, progress and memory. `recorded_state` makes a state
directory of a recording.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.serve.daemon import Daemon
    from camtopod.serve.recorded_state import RecordedState

__all__ = [
    "Daemon",
    "RecordedState",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "Daemon": "daemon",
        "RecordedState": "recorded_state",
    },
)
