"""Evidence that was not fitted to itself: each half of the time judged by what the other half learned.

A flexible fit finds something in any data; how well it explains the data it was fitted to says little. So the window
is cut into alternating stretches of time, the links are fitted on the odd ones and on the even ones, and each fit is
asked how much better it predicts the arrivals of the other stretches with a pair of zones than without. Where zones
have nothing to do with each other the likelihood ratio of such a prediction exceeds ``exp(x)`` with a probability of
at most ``exp(-x)`` (Markov's inequality; "safe testing", Grunwald, de Heide and Koolen 2024), whatever shape the fit
could have taken.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.candidates import Arrivals, Candidates, Departures
from camtopod.learn.joint import SPARSITY, Fit, JointFitter
from camtopod.learn.lags import LagBins

Floats = NDArray[np.float64]

STRETCHES = 16
"""The window is cut into about this many stretches ..."""
STRETCH_SECONDS_MAX = 3600.0
STRETCH_LAGS_MIN = 4.0
"""... but none shorter than this many times the longest transit, unless the window is too short for two."""
SWEEPS = 3
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
    stretch = min(max(span / STRETCHES, STRETCH_LAGS_MIN * bins.lag_max), STRETCH_SECONDS_MAX, span / 2)
    left, came = (np.floor((t - first) / stretch).astype(np.int64) % 2 for t in (departures.t, arrivals.t))
    halves = [_half(departures, left == k, arrivals, came == k, fit, bins, zones, until) for k in (0, 1)]
    hazards = [half.run(fit.hazard).hazard for half in halves]
    parts = [_evidence(half, hazards[1 - k], fit.outside) for k, half in enumerate(halves)]
    (unrelated, untimed), (also_unrelated, also_untimed) = parts
    result: Floats = np.minimum(unrelated + also_unrelated, untimed + also_untimed)
    return result


def _half(
    departures: Departures, left: NDArray[np.bool_], arrivals: Arrivals, came: NDArray[np.bool_], fit: Fit,
    bins: LagBins, zones: int, until: float,
) -> JointFitter:  # fmt: skip
    """The fit's candidates with both ends in one half, pairs numbered as in the fit."""
    c = fit.candidates
    kept = np.flatnonzero(left[c.departure] & came[c.arrival])
    departure, arrival = (np.cumsum(mask, dtype=np.int32) - 1 for mask in (left, came))
    candidates = Candidates(
        departure[c.departure[kept]], arrival[c.arrival[kept]], c.pair[kept], c.lag[kept], c.source, c.target
    )
    d, a = departures, arrivals
    fitter = JointFitter(
        Departures(d.t[left], d.zone[left], d.camera[left], d.since[left], d.slow[left]),
        Arrivals(a.t[came], a.zone[came], a.camera[came], a.rate[came], a.slow[came]),
        candidates, bins, zones, until,
    )  # fmt: skip
    fitter.sparsity, fitter.outside = SPARSITY, fit.outside
    fitter.use(fit.persistence)
    return fitter


def _evidence(half: JointFitter, hazard: Floats, outside: Floats) -> tuple[Floats, Floats]:
    """Log likelihood ratios (P,) of each pair against no link and against a link without a transit time."""
    half.outside = outside
    share = np.minimum(half.expect_afresh(hazard, SWEEPS), RESPONSIBILITY_MAX)
    c = half.candidates
    expected: Floats = (hazard * half.exposure[c.source] * half.bins.widths).sum(axis=1)
    unrelated: Floats = np.bincount(c.pair, -np.log1p(-share), minlength=half.pairs) - expected
    flat = np.minimum(half.flatness(hazard), FLAT_MAX)
    untimed: Floats = np.bincount(c.pair, -np.log1p(share * (flat - 1.0)), minlength=half.pairs).astype(float)
    return unrelated, untimed
