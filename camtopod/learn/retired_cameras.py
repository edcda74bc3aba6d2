"""Retire cameras that no longer report, as every name costs memory and counts towards the limit.

A camera is retired when its last event is older than the window (`cameras_to_retire`). As nothing
that is learned depends on it any more, it is forgotten, except for the shapes of its zones: a
camera that returns gets its zone numbers back. When the limit of cameras is reached, a new camera
replaces the one with the fewest events in the window among those silent for an hour
(`camera_to_replace`). `forget_cameras` renumbers the others.
"""

from __future__ import annotations

from collections.abc import Set

import numpy as np

from camtopod.arrays import Longs
from camtopod.event_time import MICROSECONDS
from camtopod.learn.association import FollowedSources, place
from camtopod.learn.snapshot import LearnerState
from camtopod.learn.window import NONE, ReorderBuffer, Window

REPLACEABLE_AFTER_SECONDS = 3600.0
"""Time, in seconds of event time, without events after which a new camera may replace a camera."""


def cameras_to_retire(
    reorder_buffer: ReorderBuffer, window: Window, now_us: int, window_us: int
) -> set[str]:
    """Return the names of the cameras to retire now.

    reorder_buffer: knows the newest event of each camera, and holds events that are not in the
        window yet.
    window: the events that count for learning.
    now_us (microseconds): event time.
    window_us (microseconds): length of the window.
    """
    newest = reorder_buffer.state.newest
    t_us = now_us - window_us
    return {name for name in (*newest, *window.cameras) if newest.get(name, t_us - 1) < t_us}


def camera_to_replace(reorder_buffer: ReorderBuffer, window: Window) -> str | None:
    """Return the camera to be replaced by a new one; None if none has been silent for long.

    reorder_buffer, window: as for `cameras_to_retire`.
    """
    newest = reorder_buffer.state.newest
    watermark_us = reorder_buffer.time.state.watermark_us
    silent_us = (watermark_us or 0) - round(REPLACEABLE_AFTER_SECONDS * MICROSECONDS)

    # The usual case: it begins with the camera whose last event was received first.
    if not newest or newest[next(iter(newest))] >= silent_us:
        return None

    # Of the silent cameras, the one with the fewest events.
    events = dict(zip(window.cameras, window.events_of_cameras().tolist(), strict=True))
    held_cameras = reorder_buffer.cameras_held()
    silent = [
        (events.get(name, 0), t_us, name)
        for name, t_us in newest.items()
        if t_us < silent_us and name not in held_cameras
    ]
    return min(silent, default=(0, 0, None))[-1]


def forget_cameras(state: LearnerState, names: Set[str], number: Longs) -> None:
    """Forget cameras in what the state numbers or names beside window, intake and scorer.

    number (cameras,): new index of each camera, `NONE` for these.
    """
    mask = number != NONE
    state.clocks.keep_cameras(mask)
    rows = np.flatnonzero(mask[: len(state.cameras)])
    state.cameras = [state.cameras[k] for k in rows]
    state.moved = [
        (int(number[camera]), since, move) for camera, since, move in state.moved if mask[camera]
    ]
    state.publishers = {
        name: publisher for name, publisher in state.publishers.items() if name not in names
    }
    state.doubled = [name for name in state.doubled if name not in names]
    state.followed = _renumber_followed(state.followed, number)


def _renumber_followed(
    sources_by_place: dict[int, FollowedSources], number: Longs
) -> dict[int, FollowedSources]:
    """Renumber the cameras in the state of `CandidateScreen`.

    sources_by_place: zones of departure that are followed for each zone of arrival; zones are given
        by their keys (`place`), which contain the index of the camera.
    number (cameras,): new index of each camera, `NONE` for retired ones.
    """
    result = {}
    for target, record in sources_by_place.items():
        for new_target in _moved(np.array([target]), number).tolist():
            result[new_target] = FollowedSources(_moved(record.sources, number), record.looked)
    return result


def _moved(keys: Longs, number: Longs) -> Longs:
    """Return the new keys of zones, without those of forgotten cameras.

    number (cameras,): new index of each camera.
    """
    camera, zone = np.divmod(keys, place(1, 0))
    mask = number[camera] != NONE
    return place(number[camera[mask]], zone[mask])
