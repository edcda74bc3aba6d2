"""Rename a camera in the saved state of a learner, keeping everything learned about it."""

from __future__ import annotations

from typing import TypeVar

from msgspec.structs import replace

from camtopod.learn.snapshot import LearnerState
from camtopod.topology import renamed

_Value = TypeVar("_Value")


def rename(state: LearnerState, old: str, new: str) -> LearnerState:
    """Return the state with the camera ``old`` under the name ``new``, which must not be in it.

    The newest version keeps the old name: make another with `Learner.make_version`. Until then the
    scorer has no predictor.
    """
    names = {old: new}

    def name(camera: str) -> str:
        return names.get(camera, camera)

    def keys(table: dict[str, _Value]) -> dict[str, _Value]:
        """Return a dictionary with the camera renamed; the order stays."""
        return {name(camera): value for camera, value in table.items()}

    # Events.
    time = state.intake.time
    leader = None if time.leader is None else name(time.leader)
    intake = replace(
        state.intake,
        time=replace(time, leader=leader, waited=keys(time.waited)),
        held=[replace(event, camera=name(event.camera)) for event in state.intake.held],
        newest=keys(state.intake.newest),
        numbers=keys(state.intake.numbers),
    )

    # Alarms, with those raised before.
    alarms = replace(
        state.alarms,
        newest=[
            replace(alarm, subject=renamed(alarm.subject, old, new))
            for alarm in state.alarms.newest
        ],
        reported={renamed(subject, old, new): t for subject, t in state.alarms.reported.items()},
        joined={renamed(link, old, new) for link in state.alarms.joined},
        silent=keys(state.alarms.silent),
        clock=keys(state.alarms.clock),
        repeats=keys(state.alarms.repeats),
    )

    # Predictions.
    scorer = replace(
        state.scorer,
        predictor=None,
        baseline={camera: keys(shares) for camera, shares in keys(state.scorer.baseline).items()},
        waiting=[
            prediction._replace(
                camera=name(prediction.camera),
                shares=keys(prediction.shares),
                baseline=keys(prediction.baseline),
            )
            for prediction in state.scorer.waiting
        ],
    )
    return replace(
        state,
        intake=intake,
        window=replace(state.window, cameras=[name(camera) for camera in state.window.cameras]),
        alarms=alarms,
        scorer=scorer,
        publishers=keys(state.publishers),
        doubled=[name(camera) for camera in state.doubled],
        retired=keys(state.retired),
        names={
            **{before: name(now) for before, now in (state.names or {}).items() if before != new},
            old: new,
        },
    )
