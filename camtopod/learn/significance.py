"""Is it a link? Significance of every pair of zones, and what missed passages explain away.

The evidence for a pair is the log likelihood ratio between the joint fit with and without it. Because the fit leaves
every arrival out of its own prediction, the ratio is one of prediction, not of fit: under chance ``P(ratio > x)`` is
at most about ``exp(-x)``, whatever shape the histogram could have taken. Those p-values are turned into false
discovery rates (Benjamini and Hochberg 1995).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

RESPONSIBILITY_MAX = 1.0 - 1e-6
FLAT_MAX = 1e6
MISSED_LAG_SD = 3.0
"""A way over a missed passage must fit the link's median lag within this many standard deviations."""


def log_likelihood_ratio(pair: Ints, responsibility: Floats, flat: Floats, pairs: int) -> Floats:
    """Evidence (P,) in nats for each pair from the responsibilities (M,) of its candidates.

    Against two nulls, the stronger counts: the zones have nothing to do with each other; or arrivals at one follow
    departures from the other at no particular lag, as when both follow a rhythm (``flat`` (M,): hazard of that over
    hazard).
    """
    share = np.minimum(responsibility, RESPONSIBILITY_MAX)
    unrelated = np.bincount(pair, -np.log1p(-share) - share, minlength=pairs)
    untimed = np.bincount(pair, -np.log1p(share * (np.minimum(flat, FLAT_MAX) - 1.0)), minlength=pairs)
    return np.minimum(unrelated, untimed)


def q_values(ratio: Floats, tests: int) -> Floats:
    """False discovery rate (P,) at which each pair would be published, among ``tests`` pairs looked at."""
    p = np.exp(-np.maximum(ratio, 0.0))
    order = np.argsort(p, kind="stable")
    adjusted = p[order] * max(tests, 1) / np.arange(1, len(p) + 1)
    q = np.empty(len(p))
    q[order] = np.minimum(np.minimum.accumulate(adjusted[::-1])[::-1], 1.0)
    return q


class Ways(dict[int, list[tuple[int, float, float, float]]]):
    """Directed weighted ways by source zone: (target zone, probability, median seconds, sd seconds)."""


def explained_by_missed(
    source: int, target: int, probability: float, median: float, links: Ways, passages: Ways, missed_share_max: float
) -> bool:
    """Whether source -> target is what remains of source -> (a camera that missed the passage) -> target.

    ``links`` are the ways between cameras, ``passages`` those through them. Of those leaving at the source, a share
    walks source -> a, a -> b through one camera, b -> target; if that camera misses at most ``missed_share_max`` of
    all passages, at most odds of it times the share seen on that way can turn up as a direct link.
    """
    odds = missed_share_max / (1.0 - missed_share_max)
    total = 0.0
    for a, p_in, median_in, sd_in in links.get(source, []):
        for b, p_through, median_through, sd_through in passages.get(a, []):
            for end, p_out, median_out, sd_out in links.get(b, []):
                if end != target:
                    continue
                spread = np.sqrt(sd_in**2 + sd_through**2 + sd_out**2) + 1.0
                if abs(median_in + median_through + median_out - median) <= MISSED_LAG_SD * spread:
                    total += p_in * p_through * p_out
    return probability <= odds * total
