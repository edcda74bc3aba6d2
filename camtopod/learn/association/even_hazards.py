"""How far a lag speaks for a transition: hazards beside those that are the same at every lag."""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, Singles, row_slices
from camtopod.learn.association.em import NOTHING, Em


def flatness(em: Em, hazard: Singles) -> Floats:
    """Return the ratio (M,) of each pair's hazard spread evenly over all lags to its hazard.

    hazard (P, bins): the hazards of the pairs of zones of a fit.

    The ratio is taken for each candidate, at its lag. It is small where the lag speaks for a
    transition, and 1 where the lag says nothing.
    """
    # Hazards (P,) that are the same at every lag and give as many transitions.
    even = np.zeros(em.pairs)
    c = em.candidates
    bins = em.problem.bins
    one_view = em.camera[c.source] == em.camera[c.target]
    before = bins.edges[1:] <= 0
    for rows in row_slices(em.pairs):
        seconds = em.exposure[em.range_of[rows]] * bins.widths
        seconds[one_view[rows, None] & before] = 0.0  # in one view no lag is before the exit
        total = np.maximum(seconds.sum(axis=1), 1e-9)
        even[rows] = (hazard[rows] * seconds).sum(axis=1) / total

    flat: Floats = even[c.pair] / np.maximum(hazard.take(em.cell), NOTHING)
    return flat
