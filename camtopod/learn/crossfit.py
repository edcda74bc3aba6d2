"""Evidence that was not fitted to itself: each part of the time judged by what the rest of the time taught.

A flexible fit finds something in any data; how well it explains the data it was fitted to says little. So the window is
cut into stretches of time dealt out to a few folds; for each fold the links are fitted on the others, from nothing, and
asked how much better they predict its arrivals with a pair of zones than without. Where zones have nothing to do with
each other, the likelihood ratio of one fold's prediction exceeds ``exp(x)`` with a probability of at most ``exp(-x)``,
whatever shape the fit could have taken (Markov's inequality; Wasserman, Ramdas and Balakrishnan 2020). The folds share
most of what they learned from, so their sum is no product of independent ratios: it counts for `SUM_WEIGHT` of itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.candidates import Arrivals, Candidates, Departures
from camtopod.learn.joint import SPARSITY, Fit, JointFitter
from camtopod.learn.lags import LagBins

Floats = NDArray[np.float64]

FOLDS = 4
STRETCHES = 32
"""The window is cut into about this many stretches, dealt out to the folds in turn ..."""
STRETCH_SECONDS_MAX = 3600.0
STRETCH_LAGS_MIN = 4.0
"""... but none shorter than this many times the longest transit, unless the window is too short for that."""
SUM_WEIGHT = 0.75
"""Share of the folds' summed evidence that counts. Theory guarantees a quarter (the mean); on made-up networks without
links three quarters keeps the rate of false links to what the q-values say.
"""
SWEEPS = 3
ROUNDS = 1
"""Rounds of each fit before the last."""
RESPONSIBILITY_MAX = 1.0 - 1e-9
FLAT_MAX = 1e6


def cross_evidence(
    departures: Departures, arrivals: Arrivals, fit: Fit, bins: LagBins, zones: int, first: float, until: float
) -> Floats:
    """Log likelihood ratio (P,) in nats of each pair of zones of ``fit`` over the window from ``first`` to ``until``.

    Against two nulls, the stronger counts: the zones have nothing to do with each other; or arrivals at one follow
    departures from the other at no particular lag, as when both follow a rhythm.
    """
    span = max(until - first, 1.0)
    stretch = min(max(span / STRETCHES, STRETCH_LAGS_MIN * bins.lag_max), STRETCH_SECONDS_MAX, span / FOLDS)
    left, came = (np.floor((t - first) / stretch).astype(np.int64) % FOLDS for t in (departures.t, arrivals.t))
    unrelated, untimed = np.zeros((2, len(fit.candidates.source)))
    for fold in range(FOLDS):
        rest = _part(departures, left != fold, arrivals, came != fold, fit, bins, zones, until)
        part = _part(departures, left == fold, arrivals, came == fold, fit, bins, zones, until)
        more_unrelated, more_untimed = _evidence(part, _fitted(rest), fit.outside)
        unrelated += more_unrelated
        untimed += more_untimed
    return SUM_WEIGHT * np.minimum(unrelated, untimed)


def _fitted(fitter: JointFitter) -> Floats:
    """Hazards (P, bins) from one part of the time alone and from nothing; the sparse prior comes in at the end."""
    fitter.sparsity = 0.0
    hazard = fitter.start()
    for _ in range(ROUNDS):
        hazard = fitter.run(hazard).hazard
    fitter.sparsity = SPARSITY
    return fitter.run(hazard).hazard


def _part(
    departures: Departures, left: NDArray[np.bool_], arrivals: Arrivals, came: NDArray[np.bool_], fit: Fit,
    bins: LagBins, zones: int, until: float,
) -> JointFitter:  # fmt: skip
    """The fit's candidates with both ends in one part of the time, pairs numbered as in the fit."""
    c = fit.candidates
    kept = np.flatnonzero(left[c.departure] & came[c.arrival])
    departure, arrival = (np.cumsum(mask, dtype=np.int32) - 1 for mask in (left, came))
    candidates = Candidates(
        departure[c.departure[kept]], arrival[c.arrival[kept]], c.pair[kept], c.lag[kept], c.source, c.target
    )
    fitter = JointFitter(departures.take(left, came), arrivals.take(came), candidates, bins, zones, until)
    fitter.use(fit.persistence)
    return fitter


def _evidence(fitter: JointFitter, hazard: Floats, outside: Floats) -> tuple[Floats, Floats]:
    """Log likelihood ratios (P,) of each pair against no link and against a link without a transit time."""
    fitter.outside = outside
    share = np.minimum(fitter.expect_afresh(hazard, SWEEPS), RESPONSIBILITY_MAX)
    c = fitter.candidates
    expected: Floats = (hazard * fitter.exposure[c.source] * fitter.bins.widths).sum(axis=1)
    unrelated: Floats = np.bincount(c.pair, -np.log1p(-share), minlength=fitter.pairs) - expected
    flat = np.minimum(fitter.flatness(hazard), FLAT_MAX)
    untimed: Floats = np.bincount(c.pair, -np.log1p(share * (flat - 1.0)), minlength=fitter.pairs).astype(float)
    return unrelated, untimed
