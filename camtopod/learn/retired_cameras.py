"""Cameras that leave. Names may be invented, misspelled or used for a day, and every name costs a
place and memory.

A camera has left when it has had no event for a week, nor for as long as the window goes back
(``window_hours``): nothing that is learned depends on it any more, and it is forgotten. Little is
kept, and of a limited number of cameras: the shapes of its zones, so that one that returns, from a
holiday say, has their numbers back. When all places (``cameras_max``) are taken, a new camera gets
that of the one with the fewest events in the window, of those silent for an hour.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camtopod.event_time import MICROSECONDS
from camtopod.learn.association import Followed, place
from camtopod.learn.window import GONE, Intake, Window

STAYS_SECONDS = 7 * 86_400.0
"""Event time. A camera without events stays at least so long, listed without zones."""
LEFT_CAMERAS_MAX = 10_000
"""Cameras that have left whose zones' numbers are kept; beyond, the one that left first is
forgotten altogether.
"""
GIVES_WAY_SECONDS = 3600.0
"""Event time. When there are too many cameras, one silent for longer may give its place to
another.
"""
_CAMERA_SHIFT = 32
"""Of what a zone is known by, see `place`."""


def left_by(intake: Intake, window: Window, now_us: int, window_us: int) -> set[str]:
    """Cameras that have left when event time is ``now_us`` and the window goes back ``window_us``
    (microseconds).
    """
    newest, t_us = intake.newest_of, now_us - max(window_us, round(STAYS_SECONDS * MICROSECONDS))
    silent = {
        name for name in (*intake.cameras, *window.cameras) if newest.get(name, t_us - 1) < t_us
    }
    if not silent:
        return silent
    # Of some it may not be known when they were heard last: in the snapshots of older programs it
    # is not said.
    return silent - window.cameras_present() - intake.held_of()


def gives_way(intake: Intake, window: Window) -> str | None:
    """The camera that gives its place to a new one; None if none has been silent for long."""
    newest, watermark_us = intake.newest_of, intake.watermark_us
    silent_us = (watermark_us or 0) - round(GIVES_WAY_SECONDS * MICROSECONDS)
    if (
        not newest or newest[next(iter(newest))] >= silent_us
    ):  # as usual: the one heard last longest ago is not silent
        return None
    events = dict(zip(window.cameras, window.events_of_cameras().tolist(), strict=True))
    held = intake.held_of()
    silent = [
        (events.get(name, 0), t_us, name)
        for name, t_us in newest.items()
        if t_us < silent_us and name not in held
    ]
    return min(silent)[-1] if silent else None


def renumbered(followed: dict[int, Followed], number: NDArray[np.int64]) -> dict[int, Followed]:
    """What `Screen` follows, by `place`, after cameras were numbered anew: ``number`` (cameras,),
    `GONE` for those that have left.
    """
    result = {}
    for target, known in followed.items():
        if number[target >> _CAMERA_SHIFT] != GONE:
            sources = known.sources[number[known.sources >> _CAMERA_SHIFT] != GONE]
            moved = np.array([_moved(source, number) for source in sources.tolist()], np.int64)
            result[_moved(target, number)] = Followed(moved, known.looked)
    return result


def _moved(old: int, number: NDArray[np.int64]) -> int:
    return place(int(number[old >> _CAMERA_SHIFT]), old & ((1 << _CAMERA_SHIFT) - 1))
