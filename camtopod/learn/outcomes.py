"""Outcomes of earlier exits: the probability of each camera to be the one that saw the object next.

The learner scores its own predictions with these (`self_score`). Objects are anonymous, so an
outcome is never certain, but once the longest lag after an exit has passed, the fit of a later
version gives the probability of each possible arrival.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import takewhile
from typing import NamedTuple

import numpy as np

from camtopod.arrays import Floats
from camtopod.learn.next_camera import Posterior
from camtopod.learn.traffic import Arrivals, Departures

Happened = dict[str, float]
"""Probability that the object appeared next at each camera; the rest has left the site."""


class ScoredPrediction(NamedTuple):
    """A prediction that is to be scored.

    Probabilities are by name of the next camera, with "" for leaving the site.
    """

    t: float
    """Time of the exit by the camera's own clock, Unix seconds."""
    camera: str
    """Camera of the exit."""
    version: int
    """Version with which the prediction was made."""
    shares: dict[str, float]
    """Predicted probabilities."""
    baseline: dict[str, float]
    """Probabilities of the baseline, the Markov chain over cameras."""
    reach: float = 180.0
    """Longest lag of that version, seconds: who appears later counts as having left the site."""


def outcomes_of(
    exits: Sequence[ScoredPrediction],
    posterior: Posterior,
    departures: Departures,
    arrivals: Arrivals,
    cameras: list[str],
    offsets: Floats,
    longest: float,
    until: float,
) -> list[Happened | None]:
    """Return the outcomes of the exits that have one by now; None if the fit has no such exit.

    An exit has an outcome when the longest lag is over, that of its version and that of the fit.

    exits: predictions of exits, sorted by time.
    departures, arrivals: those of the fit, in corrected time.
    cameras: names of all cameras.
    offsets (cameras,): clock offset of each camera, seconds.
    longest: longest lag of the fit, seconds.
    until (Unix seconds): end of the window.
    """
    # The row of each exit among the departures; -1 if it is not there. Of exits at one camera with
    # one stamp, each has a row of its own.
    rows, reach = list[int](), list[float]()
    for exit_ in takewhile(lambda exit_: exit_.t + max(exit_.reach, longest) <= until, exits):
        camera = cameras.index(exit_.camera)
        t = exit_.t - offsets[camera]
        low, high = np.searchsorted(departures.t, (t, np.nextafter(t, np.inf)))
        rows_of_exit = low + np.flatnonzero(departures.camera[low:high] == camera)
        rows.append(next((row for row in rows_of_exit.tolist() if row not in rows), -1))
        reach.append(exit_.reach)

    # The probability of each next camera, by name.
    shares = _shares(posterior, len(departures.t), arrivals, rows, reach, len(cameras))
    return [
        None if row < 0 else {cameras[k]: float(share[k]) for k in np.flatnonzero(share)}
        for row, share in zip(rows, shares, strict=True)
    ]


def _shares(
    posterior: Posterior,
    departures: int,
    arrivals: Arrivals,
    rows: list[int],
    reach: list[float],
    cameras: int,
) -> Floats:
    """Return the probability of each camera to see the object of a departure next, (k, cameras).

    departures: number of departures.
    rows: k departures; -1 for none.
    reach: longest lag of each of them that counts, seconds.
    cameras: number of cameras.

    The spurious share of each candidate does not count.
    """
    result = np.zeros((len(rows), cameras))
    c = posterior.fit.candidates
    number = np.full(departures + 1, -1)  # the last is for exits without a departure
    number[rows] = np.arange(len(rows))
    within = np.append(reach, 0.0)[number[c.departure]]
    candidate_rows = np.flatnonzero((number[c.departure] >= 0) & (c.lag <= within))
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
