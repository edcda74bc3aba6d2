"""Candidates with a negative lag: an object in two views at once, which have to overlap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Bools, Singles
from camtopod.learn.association.candidates import RESPONSIBILITY_MAX, Candidates
from camtopod.learn.association.problem import Problem

OVERLAP_FALSE = 0.05
"""Probability that `negative_without_overlap` finds any overlap on a site without overlaps."""


def negative_without_overlap(
    problem: Problem,
    candidates: Candidates,
    responsibility: Singles,
    overlap: Bools,
) -> NDArray[np.bool_]:
    """Return a mask (M,) of candidates with a negative lag between views that do not overlap.

    Such candidates are impossible: an object does not appear in the next view before it leaves the
    first one. Two views are taken to overlap if the search for overlapping views has found it, or
    if the candidates with a negative lag, over all zones of the two and in both directions, have
    more evidence than the null model gives any pair of cameras with probability `OVERLAP_FALSE`.

    responsibility (M,): probability that the candidate is of one object.
    overlap (cameras, cameras): True where the search found an overlap.
    """
    # Number the pairs of cameras among the candidates with a negative lag.
    cameras = len(overlap)
    c = candidates
    ahead = np.flatnonzero(c.lag < 0)
    camera_left = problem.departures.camera[c.departure[ahead]]
    camera_reached = problem.arrivals.camera[c.arrival[ahead]]
    views = np.minimum(camera_left, camera_reached).astype(np.int64) * cameras + np.maximum(
        camera_left, camera_reached
    )
    present, pair = np.unique(views, return_inverse=True)

    # Responsibility of each arrival, added up over its candidates from one camera.
    key, number = np.unique(
        c.arrival[ahead].astype(np.int64) * cameras + camera_left, return_inverse=True
    )
    arrival_share = np.minimum(
        np.bincount(number, responsibility[ahead], minlength=len(key)), RESPONSIBILITY_MAX
    )

    # Evidence of each pair of cameras, against a Bonferroni threshold over all pairs.
    of_key = np.zeros(len(key), np.int64)
    of_key[number] = pair
    nats = np.bincount(of_key, -np.log1p(-arrival_share) - arrival_share, minlength=len(present))
    overlaps = nats >= np.log(max(cameras * (cameras - 1) / 2, 1.0) / OVERLAP_FALSE)
    overlaps |= (overlap | overlap.T)[present // cameras, present % cameras]

    result = np.zeros(len(c.lag), bool)
    result[ahead] = ~overlaps[pair]
    return result
