"""Outcomes of earlier exits: the probability of each camera to be the one that saw the object next.

The learner scores its own predictions with these (`self_score`). Objects are anonymous, so an
outcome is never certain, but once the longest lag after an exit has passed, the fit of a later
version gives the probability of each possible arrival.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from camtopod.arrays import Floats
from camtopod.learn.next_camera import Posterior
from camtopod.learn.traffic import Arrivals, Departures

Happened = dict[str, float]
"""Probability that the object appeared next at each camera; the rest has left the site."""


class Exit(Protocol):
    """An exit of an object from the view of a camera."""

    @property
    def t(self) -> float:
        """Event time by the camera's own clock, Unix seconds."""

    @property
    def camera(self) -> str:
        """Name of the camera."""


def outcomes_of(
    exits: Sequence[Exit],
    posterior: Posterior,
    departures: Departures,
    arrivals: Arrivals,
    cameras: list[str],
    offsets: Floats,
    until: float,
) -> list[Happened | None]:
    """Return the outcome of each of the exits up to ``until``; None if the fit has no such exit.

    exits: sorted by time.
    departures, arrivals: those of the fit, in corrected time.
    cameras: names of all cameras.
    offsets (cameras,): clock offset of each camera, seconds.
    until (Unix seconds): later exits may still have an arrival, so their outcome is not known.
    """
    # The exits whose outcome is known.
    known_exits = []
    for one in exits:
        if one.t > until:
            break
        known_exits.append(one)

    # The probability of each next camera.
    rows = [_row_of(one, departures, cameras, offsets) for one in known_exits]
    known = [row for row in rows if row is not None]
    shares = iter(_shares(posterior, arrivals, known, len(cameras)))

    # By name of the camera.
    outcomes: list[Happened | None] = []
    for row in rows:
        if row is None:
            outcomes.append(None)
        else:
            share = next(shares)
            outcomes.append({cameras[k]: float(share[k]) for k in np.flatnonzero(share)})
    return outcomes


def _row_of(one: Exit, departures: Departures, cameras: list[str], offsets: Floats) -> int | None:
    """Return the row of an exit in the table of departures; None if it is not there.

    Arguments are as for `outcomes_of`.
    """
    camera = cameras.index(one.camera)
    t = one.t - offsets[camera]
    low, high = np.searchsorted(departures.t, (t, np.nextafter(t, np.inf)))
    rows = low + np.flatnonzero(departures.camera[low:high] == camera)
    return int(rows[0]) if len(rows) else None


def _shares(posterior: Posterior, arrivals: Arrivals, rows: list[int], cameras: int) -> Floats:
    """Return the probability of each camera to see the object of a departure next, (k, cameras).

    rows: k departures.
    cameras: number of cameras.

    The spurious share of each candidate does not count.
    """
    result = np.zeros((len(rows), cameras))
    c = posterior.fit.candidates
    number = np.full(int(c.departure.max(initial=-1)) + 1, -1)
    for k, row in enumerate(rows):
        if row < len(number):
            number[row] = k

    candidate_rows = np.flatnonzero(number[c.departure] >= 0)
    sure = posterior.fit.responsibility[candidate_rows] * (
        1.0 - posterior.doubt[c.pair[candidate_rows]]
    )
    np.add.at(
        result,
        (number[c.departure[candidate_rows]], arrivals.camera[c.arrival[candidate_rows]]),
        sure,
    )

    total = result.sum(axis=1, keepdims=True)
    shares: Floats = result / np.maximum(total, 1.0)
    return shares
