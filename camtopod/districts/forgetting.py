"""A learner's state without some of its cameras, as if they had never been heard."""

from __future__ import annotations

from collections.abc import Set

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from camtopod.learn.clocks import ClockState
from camtopod.learn.intake import IntakeState
from camtopod.learn.scoring import ScorerState
from camtopod.learn.screening import Followed, place
from camtopod.learn.snapshot import LearnerState
from camtopod.learn.window import NO_MATE, WindowState

GONE = -1
CAMERA_SHIFT = 32
"""Of what a zone is known by, see `place`."""


def without(state: LearnerState, gone: Set[str]) -> LearnerState:
    """The state without the cameras ``gone``; what was learned of others through them stays. Events that wait for the
    watermark stay, too.
    """
    names = state.window.cameras
    kept = np.array([name not in gone for name in names], np.bool_)
    number: NDArray[np.int64] = np.where(kept, np.cumsum(kept) - 1, GONE)
    return replace(
        state,
        intake=_intake(state.intake, gone), window=_window(state.window, kept, number),
        clocks=_clocks(state.clocks, kept), scorer=_scorer(state.scorer, gone),
        cameras=[camera for camera, stays in zip(state.cameras, kept.tolist(), strict=False) if stays],
        moved=[(int(number[camera]), *rest) for camera, *rest in state.moved if kept[camera]],
        followed=_followed(state.followed, number),
        publishers={camera: one for camera, one in state.publishers.items() if camera not in gone},
        doubled=[camera for camera in state.doubled if camera not in gone],
    )  # fmt: skip


def _intake(state: IntakeState, gone: Set[str]) -> IntakeState:
    return replace(
        state, cameras=[camera for camera in state.cameras if camera not in gone],
        seen=[row for row in state.seen if row[0] not in gone],
        behind={camera: behind for camera, behind in state.behind.items() if camera not in gone},
    )  # fmt: skip


def _window(state: WindowState, kept: NDArray[np.bool_], number: NDArray[np.int64]) -> WindowState:
    """Rows and cameras are numbered anew; a mate that is older than the window stays so."""
    rows = kept[state.columns["camera"]]
    moved = np.where(rows, state.base + np.cumsum(rows) - 1, NO_MATE)
    columns = {name: column[rows] for name, column in state.columns.items()}
    mate = columns["mate"]
    columns["mate"] = np.where(mate >= state.base, moved[np.maximum(mate - state.base, 0)], mate)
    columns["camera"] = number[columns["camera"]].astype(np.int32)
    return WindowState(
        state.base, [name for name, stays in zip(state.cameras, kept.tolist(), strict=True) if stays],
        [seen for seen, stays in zip(state.seen, kept.tolist(), strict=True) if stays],
        [
            (int(number[camera]), track, int(moved[row - state.base]))
            for camera, track, row in state.open if kept[camera] and row >= state.base
        ],
        columns,
    )  # fmt: skip


def _clocks(state: ClockState, kept: NDArray[np.bool_]) -> ClockState:
    known = kept[: len(state.offset)]  # a camera that is new is not among them
    return ClockState(state.offset[known], state.sd[known], state.identified[known], state.looked)


def _scorer(state: ScorerState, gone: Set[str]) -> ScorerState:
    return replace(state, guesses=[guess for guess in state.guesses if guess.camera not in gone])


def _followed(followed: dict[int, Followed], number: NDArray[np.int64]) -> dict[int, Followed]:
    """What is known by `place`, whose cameras are numbered anew."""
    result = {}
    for target, known in followed.items():
        if number[target >> CAMERA_SHIFT] != GONE:
            sources = known.sources[number[known.sources >> CAMERA_SHIFT] != GONE]
            result[_moved(target, number)] = Followed(
                np.array([_moved(source, number) for source in sources.tolist()], np.int64), known.looked
            )
    return result


def _moved(old: int, number: NDArray[np.int64]) -> int:
    return place(int(number[old >> CAMERA_SHIFT]), old & ((1 << CAMERA_SHIFT) - 1))
