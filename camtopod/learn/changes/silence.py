"""Find silent cameras: they report nothing for far longer than their share of the traffic allows.

The length of a gap between two events of a camera is counted in events of the other cameras: at
night all cameras are quiet, and none is silent.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, rows_by_group
from camtopod.learn.lags import FALSE_PROBABILITY

EVENTS_PER_PASSAGE = 2.0
"""Events per passage. The two are not independent, so a gap counts half its number of events."""
LONGER_THAN_BEFORE = 2.0
"""Least ratio of a lasting silence to the camera's longest earlier gap for an alarm. Some cameras
have quiet nights of their own.
"""


class CameraSilences(NamedTuple):
    """Silences of one camera."""

    intervals: list[tuple[float, float]]
    """Beginning and end of each silence, seconds; a silence that lasts ends at infinity."""
    lasts: bool
    """True if the last silence lasts and is much longer than the camera's earlier gaps
    (`LONGER_THAN_BEFORE`).
    """
    newest: float = -math.inf
    """Time of its newest event in the window, seconds; -infinity if there is none."""


def find_silences(t: Floats, camera: NDArray[np.int64], cameras: int) -> list[CameraSilences]:
    """Return the silences of every camera, from the n events of the window.

    t (n, seconds): time of each event, ascending.
    camera (n,): index of each event's camera.
    cameras: number of cameras.
    """
    return [_silences(t, rows) for rows in rows_by_group(camera, cameras)]


def silent_odds(silences: list[CameraSilences], first: float, last: float) -> Floats:
    """Return the time that each camera was silent over the time that it was not, (cameras,).

    first, last (seconds): the time that is considered.
    """
    silent = np.array(
        [
            sum(min(end, last) - begin for begin, end in camera_silences.intervals)
            for camera_silences in silences
        ]
    )
    return silent / np.maximum(last - first - silent, 1.0)


def _silences(t: Floats, rows: NDArray[np.intp]) -> CameraSilences:
    """Return the silences of one camera.

    t (n, seconds): times of the events of all cameras, ascending.
    rows (k,): rows of the camera's own events.
    """
    if len(rows) == 0:
        return CameraSilences([], False)

    # Gaps between the camera's events, in events of other cameras. A gap is a silence if its
    # probability, given the camera's share of the traffic, is below the limit.
    gaps = np.diff(np.append(rows, len(t))) - 1
    share = min(len(rows) / (len(rows) + int(gaps.sum())), 0.5)
    least = math.log(len(rows) / FALSE_PROBABILITY)
    silent = -math.log1p(-share) * gaps / EVENTS_PER_PASSAGE > least

    # Convert gaps to intervals.
    ends = np.append(t[rows[1:]], np.inf)
    intervals = [(float(t[rows[k]]), float(ends[k])) for k in np.flatnonzero(silent)]
    lasts = bool(silent[-1]) and bool(gaps[-1] > LONGER_THAN_BEFORE * gaps[:-1].max(initial=0))
    return CameraSilences(intervals, lasts, float(t[rows[-1]]))
