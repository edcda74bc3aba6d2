"""When a new version is due, by the events that have been learned since the last one."""

from __future__ import annotations

from camtopod.event_time import microseconds
from camtopod.learn.changes import BEFORE_MIN
from camtopod.learn.snapshot import LearnerState
from camtopod.learn.window import Window

FIRST_TICK_SHARE = 1 / 6
"""Length of the ticks before the first version, which somebody waits for, of later ticks'."""
REFIT_EVENTS_MIN = 10
"""Least new events for a new version, unless the last version is older than ``refit_hours``."""


def is_version_due(state: LearnerState, window: Window, tick_us: int) -> bool:
    """Return True if a new version is due at a tick (microseconds).

    A version is due with the first events; with enough new events; with a camera that was turned or
    has two publishers; or, given any new event, ``refit_hours`` after the last version.
    """
    if state.since_fit == 0 or state.fitted_us is None:
        return state.since_fit > 0
    return (
        state.since_fit >= events_for_version(state, window)
        or bool(state.moved or state.doubled)
        or tick_us - state.fitted_us >= microseconds(state.settings.refit_hours * 3600.0)
    )


def events_for_version(state: LearnerState, window: Window) -> float:
    """Return the number of new events that make a new version due."""
    return max(REFIT_EVENTS_MIN, state.settings.refit_share * len(window))


def are_zones_due(state: LearnerState, window: Window) -> bool:
    """Return True if there are four times as many events as when the zones were learned."""
    return state.since_fit >= max(BEFORE_MIN * len(window.cameras), 3 * len(window) // 4)
