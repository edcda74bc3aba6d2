"""The ticks of event time, and when a new version is due: by the events learned since the last."""

from __future__ import annotations

from camtopod.event_time import microseconds
from camtopod.learn.changes import BEFORE_MIN
from camtopod.learn.snapshot import LearnerState
from camtopod.learn.window import Window

FIRST_TICK_SHARE = 1 / 6
"""Length of a tick before the first version, as a share of later ticks: users wait for it."""
REFIT_EVENTS_MIN = 10
"""Least new events for a new version, unless the last version is older than ``refit_hours``."""


def tick_length(state: LearnerState, only_last: bool) -> int:
    """Return the length of a tick, microseconds; shorter until there is a version.

    only_last: True if there is only one, of a whole recording.
    """
    seconds = state.settings.version_seconds
    if state.fitted_us is None and not only_last:
        seconds *= FIRST_TICK_SHARE
    return microseconds(seconds)


def tick_of(t_us: int, state: LearnerState, only_last: bool) -> int:
    """Return the tick with which an event at a time is learned: the first after it and the last.

    Times are in microseconds; ``only_last`` as for `tick_length`.
    """
    tick_us = tick_length(state, only_last)
    ticks = -(-t_us // tick_us)
    if state.done_us is not None:
        ticks = max(ticks, state.done_us // tick_us + 1)
    return ticks * tick_us


def last_tick_before(t_us: int, state: LearnerState, only_last: bool) -> int:
    """Return the last tick before a time, or the one up to which all is learned if that is later.

    The arguments are those of `tick_of`.
    """
    tick_us = tick_length(state, only_last)
    last_us = (t_us - 1) // tick_us * tick_us
    return last_us if state.done_us is None else max(last_us, state.done_us)


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
