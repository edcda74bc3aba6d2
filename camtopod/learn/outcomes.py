"""What became of earlier exits: at which camera each object appeared next, as a later fit sees it.

The learner scores its own predictions with this: an outcome is known, as a probability for each
camera, once the longest lag after the exit has passed.
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
    """An exit of an object: its time by the camera's own clock, Unix seconds, and its camera."""

    @property
    def t(self) -> float:
        """Event time, Unix seconds."""

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
    """Return the outcome of each of the exits up to ``until``; None where the fit has no such exit.

    exits: by time.
    departures, arrivals: those of the fit, in corrected time.
    offsets (cameras,): each camera's clock offset, seconds.
    until: Unix seconds; later exits may still be followed by an arrival.
    """
    due = []
    for one in exits:
        if one.t > until:
            break
        due.append(one)

    rows = [_row_of(one, departures, cameras, offsets) for one in due]
    known = [row for row in rows if row is not None]
    shares = iter(_shares(posterior, arrivals, known, len(cameras)))

    outcomes: list[Happened | None] = []
    for row in rows:
        if row is None:
            outcomes.append(None)
        else:
            share = next(shares)
            outcomes.append({cameras[k]: float(share[k]) for k in np.flatnonzero(share)})
    return outcomes


def _row_of(one: Exit, departures: Departures, cameras: list[str], offsets: Floats) -> int | None:
    """Return the departure of an exit; None when it is not in the fit."""
    camera = cameras.index(one.camera)
    t = one.t - offsets[camera]
    low, high = np.searchsorted(departures.t, (t, np.nextafter(t, np.inf)))
    rows = low + np.flatnonzero(departures.camera[low:high] == camera)
    return int(rows[0]) if len(rows) else None


def _shares(posterior: Posterior, arrivals: Arrivals, rows: list[int], cameras: int) -> Floats:
    """Return the probability (rows, cameras) that each departure is followed at each camera.

    The spurious share of each candidate is left out.
    """
    result = np.zeros((len(rows), cameras))
    c = posterior.fit.candidates
    number = np.full(int(c.departure.max(initial=-1)) + 1, -1)
    for k, row in enumerate(rows):
        if row < len(number):
            number[row] = k

    asked = np.flatnonzero(number[c.departure] >= 0)
    sure = posterior.fit.responsibility[asked] * (1.0 - posterior.doubt[c.pair[asked]])
    np.add.at(result, (number[c.departure[asked]], arrivals.camera[c.arrival[asked]]), sure)

    total = result.sum(axis=1, keepdims=True)
    shares: Floats = result / np.maximum(total, 1.0)
    return shares
