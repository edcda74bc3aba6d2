"""Rewind the saved state of a learner to an earlier event time.

This is needed when a camera's wrong clock has advanced event time into the future, so that all
correct events are late. `rewind` removes the later events and takes event time back; all that
follows from earlier events stays.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from camtopod.event_time import EventTime, microseconds
from camtopod.learn.changes import AlarmState
from camtopod.learn.self_score import ScorerState
from camtopod.learn.snapshot import LearnerState
from camtopod.learn.window import ReorderBufferState, WindowState


def rewind(state: LearnerState, to: float) -> LearnerState:
    """Return the state with event time taken back to ``to`` (seconds), without later events."""
    to_us = microseconds(to)
    tick_us = microseconds(state.settings.version_seconds)
    reached = to_us // tick_us * tick_us
    return replace(
        state,
        intake=_intake(state, to_us),
        window=_window(state.window, to_us),
        alarms=_alarms(state.alarms, to),
        scorer=_scorer(state.scorer, to),
        moved=[move for move in state.moved if move[1] <= to],
        done_us=None if state.done_us is None else min(state.done_us, reached),
        fitted_us=None if state.fitted_us is None else min(state.fitted_us, reached),
    )


def _intake(state: LearnerState, to_us: int) -> ReorderBufferState:
    """Return the state of the reorder buffer with event time and watermark taken back."""
    intake = state.intake
    time = EventTime(state.settings.lateness_seconds, state.settings.ahead_seconds_max)
    time.load(intake.time)
    time.rewind(to_us)
    return replace(
        intake,
        time=time.save(),
        held=[event for event in intake.held if microseconds(event.t) <= to_us],
        newest={camera: min(t_us, to_us) for camera, t_us in intake.newest.items()},
    )


def _window(state: WindowState, to_us: int) -> WindowState:
    """Return the state of the window without later rows, which are the last ones."""
    rows = int(np.searchsorted(state.columns["t"], to_us, side="right"))
    return replace(
        state,
        columns={name: column[:rows].copy() for name, column in state.columns.items()},
        open={key: row for key, row in state.open.items() if row < state.base + rows},
    )


def _alarms(state: AlarmState, to: float) -> AlarmState:
    """Return the state of the alarms without later alarms."""
    return replace(
        state,
        newest=[alarm for alarm in state.newest if alarm.t <= to],
        reported={subject: min(t, to) for subject, t in state.reported.items()},
    )


def _scorer(state: ScorerState, to: float) -> ScorerState:
    """Return the state of the scorer without later predictions and without its predictor.

    The predictor may have observed later events; the scorer makes a new one with the next version.
    """
    return replace(state, predictor=None, waiting=[one for one in state.waiting if one.t <= to])
