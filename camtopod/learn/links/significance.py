"""Significance of every pair of zones: evidence, and the false discovery rate that it implies.

The evidence for a pair is the log likelihood ratio between the joint fit with and without it. As
the fit leaves every arrival out of its own prediction, the ratio is one of prediction, not of fit:
under the null model ``P(ratio > x)`` is at most about ``exp(-x)``, whatever the shape of the
histogram. These p-values are turned into false discovery rates (Benjamini and Hochberg 1995).
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, Ints
from camtopod.learn.association import RESPONSIBILITY_MAX

FLAT_MAX = 1e6
"""Largest ratio of a hazard without a transit time to the hazard of the fit."""


def log_likelihood_ratio(pair: Ints, responsibility: Floats, flat: Floats, pairs: int) -> Floats:
    """Return the evidence (P,) in nats for each pair of zones.

    The stronger of two null models counts (the smaller ratio): the zones are unrelated; or arrivals
    at one follow departures from the other at no particular lag, as when both follow a rhythm.

    pair (M,): pair of zones of each candidate.
    responsibility (M,): of each candidate.
    flat (M,): hazard under the second null model, over the hazard of the fit.
    pairs: number of pairs, P.
    """
    share = np.minimum(responsibility, RESPONSIBILITY_MAX)
    untimed = np.bincount(
        pair, -np.log1p(share * (np.minimum(flat, FLAT_MAX) - 1.0)), minlength=pairs
    )
    return np.minimum(evidence_against_unrelated(pair, responsibility, pairs), untimed)


def evidence_against_unrelated(pair: Ints, responsibility: Floats, pairs: int) -> Floats:
    """Return the evidence (P,) in nats against the zones being unrelated."""
    share = np.minimum(responsibility, RESPONSIBILITY_MAX)
    evidence: Floats = np.bincount(pair, -np.log1p(-share) - share, minlength=pairs).astype(float)
    return evidence


def q_values(ratio: Floats, tests: int) -> Floats:
    """Return the false discovery rate (P,) at which each pair would be published.

    ratio (P,): evidence, nats.
    tests: number of pairs of zones that were tested.
    """
    # Benjamini-Hochberg: p * tests / rank, made monotone from the largest p down.
    p = np.exp(-np.maximum(ratio, 0.0))
    order = np.argsort(p, kind="stable")
    adjusted = p[order] * max(tests, 1) / np.arange(1, len(p) + 1)
    q = np.empty(len(p))
    q[order] = np.minimum(np.minimum.accumulate(adjusted[::-1])[::-1], 1.0)
    return q


def ratio_needed(rank: int, tests: int, q_max: float) -> float:
    """Return the evidence in nats that gives a pair a false discovery rate of at most ``q_max``.

    rank: rank of the pair by evidence, from 1.
    tests: number of pairs of zones that were tested.
    """
    return float(np.log(max(tests, 1) / (max(q_max, 1e-300) * rank)))
