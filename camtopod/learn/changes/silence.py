"""Silences: cameras that report nothing for far longer than their share of the traffic allows.

Time is counted in events of the other cameras: at night all are quiet, and none is silent.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, rows_by_group

FALSE_ALARM = 1e-3
"""Probability of any false silence of a camera in one window."""
EVENTS_PER_PASSAGE = 2.0
"""Events per passage; as they are not independent, they count half as much as their number."""
LONGER_THAN_BEFORE = 2.0
"""Least ratio of a lasting silence to the camera's longest earlier gap for it to be reported.

Some cameras have quiet nights of their own.
"""
EVENTS_MIN = 10
"""Least number of events of a camera in the window for its gaps to be tested."""
PASSES = 2
"""Estimates of a camera's share of the traffic; after the first, without its silences."""


class CameraSilences(NamedTuple):
    """Silences of one camera."""

    intervals: list[tuple[float, float]]
    """Beginning and end of each, seconds; a silence that lasts ends at infinity."""
    lasts: bool
    """True if the last one lasts, and is longer than the camera's own habits explain."""


def find_silences(t: Floats, camera: NDArray[np.int64], cameras: int) -> list[CameraSilences]:
    """Return the silences of every camera from the events of the window.

    t (n, seconds): times, ascending.
    camera (n,): camera of each event.
    cameras: number of cameras.
    """
    return [_silences(t, own) for own in rows_by_group(camera, cameras)]


def _silences(t: Floats, own: NDArray[np.intp]) -> CameraSilences:
    """Return the silences of the camera whose events are the rows ``own`` of all events."""
    if len(own) < EVENTS_MIN:
        return CameraSilences([], False)

    # Gaps between its events, in events of the others. A gap is a silence if its probability, given
    # the camera's share of the traffic, is below the limit.
    gaps = np.diff(np.append(own, len(t))) - 1
    silent = np.zeros(len(gaps), bool)
    for _ in range(PASSES):
        heard = len(own) + int(gaps[~silent].sum())
        nats = -math.log1p(-min(len(own) / max(heard, 1), 0.5)) * gaps / EVENTS_PER_PASSAGE
        silent = nats > math.log(len(own) / FALSE_ALARM)

    # Convert gaps to intervals.
    ends = np.append(t[own[1:]], np.inf)
    intervals = [(float(t[own[k]]), float(ends[k])) for k in np.flatnonzero(silent)]
    lasts = bool(silent[-1]) and bool(gaps[-1] > LONGER_THAN_BEFORE * gaps[:-1].max(initial=0))
    return CameraSilences(intervals, lasts)
