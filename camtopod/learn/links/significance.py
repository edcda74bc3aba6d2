"""Is it a link? Significance of every pair of zones.

The evidence for a pair is the log likelihood ratio between the joint fit with and without it.
Because the fit leaves every arrival out of its own prediction, the ratio is one of prediction, not
of fit: under chance ``P(ratio > x)`` is at most about ``exp(-x)``, whatever shape the histogram
could have taken. Those p-values are turned into false discovery rates (Benjamini and Hochberg
1995).
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, Ints
from camtopod.learn.association import RESPONSIBILITY_MAX

FLAT_MAX = 1e6


def log_likelihood_ratio(pair: Ints, responsibility: Floats, flat: Floats, pairs: int) -> Floats:
    """Evidence (P,) in nats for each pair from the responsibilities (M,) of its candidates.

    Against two nulls, the stronger counts: the zones have nothing to do with each other; or
    arrivals at one follow departures from the other at no particular lag, as when both follow a
    rhythm (``flat`` (M,): hazard of that over hazard).
    """
    share = np.minimum(responsibility, RESPONSIBILITY_MAX)
    untimed = np.bincount(
        pair, -np.log1p(share * (np.minimum(flat, FLAT_MAX) - 1.0)), minlength=pairs
    )
    return np.minimum(unrelated(pair, responsibility, pairs), untimed)


def unrelated(pair: Ints, responsibility: Floats, pairs: int) -> Floats:
    """Evidence (P,) in nats against the zones having nothing to do with each other."""
    share = np.minimum(responsibility, RESPONSIBILITY_MAX)
    evidence: Floats = np.bincount(pair, -np.log1p(-share) - share, minlength=pairs).astype(float)
    return evidence


def q_values(ratio: Floats, tests: int) -> Floats:
    """False discovery rate (P,) at which each pair would be published, among ``tests`` pairs looked
    at.
    """
    p = np.exp(-np.maximum(ratio, 0.0))
    order = np.argsort(p, kind="stable")
    adjusted = p[order] * max(tests, 1) / np.arange(1, len(p) + 1)
    q = np.empty(len(p))
    q[order] = np.minimum(np.minimum.accumulate(adjusted[::-1])[::-1], 1.0)
    return q


def ratio_needed(rank: int, tests: int, q_max: float) -> float:
    """Evidence in nats with which a pair has a false discovery rate of at most ``q_max`` as the
    ``rank``-th clearest of ``tests`` pairs looked at.
    """
    return float(np.log(max(tests, 1) / (max(q_max, 1e-300) * rank)))
