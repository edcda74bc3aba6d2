"""Cameras that report nothing for far longer than their share of the traffic allows.

Time is counted in events of the other cameras: at night all are quiet, and none is silent.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, rows_of

FALSE_ALARM = 1e-3
"""Probability that chance makes any gap of a camera in a window a silence."""
EVENTS_PER_PASSAGE = 2.0
"""Who passes is told of twice, so that events say half as much as their number."""
LONGER_THAN_BEFORE = 2.0
"""A camera is reported silent when it has been so this many times as long as ever before: some have
nights of their own.
"""
EVENTS_MIN = 10
"""Events of a camera in the window before anything is said about it."""
PASSES = 2
"""The share of a camera is measured, and measured again without its silences."""


class Silences(NamedTuple):
    """Silences of one camera: intervals (from, to) in seconds, the last until infinity if it lasts;
    and whether that is longer than the camera's own habits explain.
    """

    intervals: list[tuple[float, float]]
    lasts: bool


def find_silences(t: Floats, camera: NDArray[np.int64], cameras: int) -> list[Silences]:
    """Silences of every camera from the window's events: ``t`` (n,) seconds, ascending, and their
    ``camera``.
    """
    return [_silences(t, own) for own in rows_of(camera, cameras)]


def _silences(t: Floats, own: NDArray[np.intp]) -> Silences:
    """From the rows ``own`` of one camera among all rows."""
    if len(own) < EVENTS_MIN:
        return Silences([], False)
    gaps = np.diff(np.append(own, len(t))) - 1
    silent = np.zeros(len(gaps), bool)
    for _ in range(PASSES):
        heard = len(own) + int(gaps[~silent].sum())
        nats = -math.log1p(-min(len(own) / max(heard, 1), 0.5)) * gaps / EVENTS_PER_PASSAGE
        silent = nats > math.log(len(own) / FALSE_ALARM)
    ends = np.append(t[own[1:]], np.inf)
    intervals = [(float(t[own[k]]), float(ends[k])) for k in np.flatnonzero(silent)]
    lasts = bool(silent[-1]) and bool(gaps[-1] > LONGER_THAN_BEFORE * gaps[:-1].max(initial=0))
    return Silences(intervals, lasts)
