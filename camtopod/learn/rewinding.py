"""Rewind the saved state of a learner to an earlier event time.

This is needed when a camera's wrong clock has advanced event time into the future, so that all
correct events are late. `rewind` removes the later events and takes event time back; all that
follows from earlier events stays.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from camtopod.event_time import EventTime, microseconds
from camtopod.learn.snapshot import LearnerState


def rewind(state: LearnerState, to: float) -> LearnerState:
    """Return the state with event time taken back to ``to`` (seconds), without later events.

    The scorer has no predictor, as that may have observed later events; the next version brings
    another.
    """
    # The reorder buffer, with event time and watermark.
    to_us = microseconds(to)
    time = EventTime(state.settings.lateness_seconds, state.settings.ahead_seconds_max)
    time.load(state.intake.time)
    time.rewind(to_us)
    intake = replace(
        state.intake,
        time=time.state,
        held=[event for event in state.intake.held if microseconds(event.t) <= to_us],
        newest={camera: min(t_us, to_us) for camera, t_us in state.intake.newest.items()},
    )

    # The window without later rows, which are the last ones.
    window = state.window
    rows = int(np.searchsorted(window.columns["t"], to_us, side="right"))
    window = replace(
        window,
        columns={name: column[:rows].copy() for name, column in window.columns.items()},
        open={key: row for key, row in window.open.items() if row < window.base + rows},
    )

    # Ticks, alarms and predictions.
    tick_us = microseconds(state.settings.version_seconds)
    last_tick_us = to_us // tick_us * tick_us
    alarms = replace(
        state.alarms,
        newest=[alarm for alarm in state.alarms.newest if alarm.t <= to],
        reported={subject: min(t, to) for subject, t in state.alarms.reported.items()},
        silent={name: min(t, to) for name, t in state.alarms.silent.items()},
        repeats={name: repeat for name, repeat in state.alarms.repeats.items() if repeat[0] <= to},
    )
    predictions = [prediction for prediction in state.scorer.waiting if prediction.t <= to]
    return replace(
        state,
        intake=intake,
        window=window,
        alarms=alarms,
        scorer=replace(state.scorer, predictor=None, waiting=predictions),
        moved=[move for move in state.moved if move[1] <= to],
        done_us=None if state.done_us is None else min(state.done_us, last_tick_us),
        fitted_us=None if state.fitted_us is None else min(state.fitted_us, last_tick_us),
    )
