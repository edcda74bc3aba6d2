"""clocks"""

from __future__ import annotations

from camtopod.learn.clocks.correlogram import (
    LAGS,
    ROWS_AT_ONCE,
    Counts,
    chance,
    correlograms,
    side_by_side,
)
from camtopod.learn.clocks.offsets import ClockKeeper, Clocks, ClockState

__all__ = [
    "LAGS",
    "ROWS_AT_ONCE",
    "ClockKeeper",
    "ClockState",
    "Clocks",
    "Counts",
    "chance",
    "correlograms",
    "side_by_side",
]
