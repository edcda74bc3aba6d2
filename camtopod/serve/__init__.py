"""Everything that can fail: the bus, the journal, the clock, the daemon around the learner."""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import names_from

if TYPE_CHECKING:
    from camtopod.serve.daemon import Daemon
    from camtopod.serve.recorded_state import RecordedState

__all__ = [
    "Daemon",
    "RecordedState",
]

__getattr__ = names_from(
    __name__,
    {
        "Daemon": "daemon",
        "RecordedState": "recorded_state",
    },
)
