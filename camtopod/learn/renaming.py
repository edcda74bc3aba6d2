"""Rename a camera in the saved state of a learner, keeping everything learned about it."""

from __future__ import annotations

from typing import TypeVar

from msgspec.structs import replace

from camtopod.learn.changes import AlarmState
from camtopod.learn.self_score import ScoredPrediction, ScorerState
from camtopod.learn.snapshot import LearnerState
from camtopod.learn.window import ReorderBufferState
from camtopod.topology import renamed

_Value = TypeVar("_Value")


def rename(state: LearnerState, old: str, new: str) -> LearnerState:
    """Return the state with the camera ``old`` under the name ``new``, which must not be in it.

    The newest version keeps the old name: make another with `Learner.make_version`.
    """
    window = replace(
        state.window, cameras=[new if name == old else name for name in state.window.cameras]
    )
    return replace(
        state,
        intake=_intake(state.intake, old, new),
        window=window,
        alarms=_alarms(state.alarms, old, new),
        scorer=_scorer(state.scorer, old, new),
        publishers=_with_new_key(state.publishers, old, new),
        doubled=[new if name == old else name for name in state.doubled],
        retired=_with_new_key(state.retired, old, new),
    )


def _with_new_key(known: dict[str, _Value], old: str, new: str) -> dict[str, _Value]:
    """Return a dictionary with a camera renamed; the order stays."""
    return {new if name == old else name: value for name, value in known.items()}


def _intake(state: ReorderBufferState, old: str, new: str) -> ReorderBufferState:
    """Return the state of the reorder buffer with a camera renamed."""
    time = replace(
        state.time,
        leader=new if state.time.leader == old else state.time.leader,
        behind=_with_new_key(state.time.behind, old, new),
    )
    return replace(
        state,
        time=time,
        held=[replace(event, camera=new) if event.camera == old else event for event in state.held],
        newest=_with_new_key(state.newest, old, new),
    )


def _alarms(state: AlarmState, old: str, new: str) -> AlarmState:
    """Return the state of the alarms with a camera renamed, in those raised before, too."""
    return replace(
        state,
        newest=[replace(alarm, subject=renamed(alarm.subject, old, new)) for alarm in state.newest],
        reported={renamed(subject, old, new): t for subject, t in state.reported.items()},
        joined={renamed(link, old, new) for link in state.joined},
        silent={new if name == old else name for name in state.silent},
        clock=_with_new_key(state.clock, old, new),
    )


def _scorer(state: ScorerState, old: str, new: str) -> ScorerState:
    """Return the state of the scorer with a camera renamed.

    It is without its predictor, which is of the version with the old name; the next version brings
    another.
    """

    def prediction(one: ScoredPrediction) -> ScoredPrediction:
        return one._replace(
            camera=new if one.camera == old else one.camera,
            predicted=_with_new_key(one.predicted, old, new),
            baseline=_with_new_key(one.baseline, old, new),
        )

    return replace(
        state,
        predictor=None,
        baseline={
            name: _with_new_key(shares, old, new)
            for name, shares in _with_new_key(state.baseline, old, new).items()
        },
        waiting=[prediction(one) for one in state.waiting],
    )
