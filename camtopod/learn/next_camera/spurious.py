"""Estimate the share of a pair's transitions that is spurious.

Among thousands of pairs of zones, chance produces a few transitions for each. In total these would
be many: an object that is not seen again would usually be predicted to appear somewhere. A single
spurious transition cannot be told from a rare path, but it contributes less evidence. Transitions
of real paths on one site contribute about equally to the likelihood: much where few objects are
under way at once and transit times are sharp, little in a crowd. Spurious transitions contribute
far less. So each pair's *evidence per transition* is compared with the site's usual value, allowing
for the spread among the site's pairs and for transitions that are too few to tell. The width of a
pair's transit times does not matter in itself: where all are broad, that is usual.

Where no pair of zones has significant evidence, the usual value has no meaning. Whether there is
any link at all is decided from all pairs together: the mean of the e-values of all possible pairs
is an e-value, too (see `links.cross_validation`).
"""

from __future__ import annotations

import numpy as np
from scipy.special import expit

from camtopod.arrays import Floats, Ints
from camtopod.learn.links import evidence_against_unrelated

SPREAD_MIN = 0.7
"""Least standard deviation of the log of the evidence per transition among real paths."""
NATS_TO_TELL = 3.0
"""Evidence of a pair, in nats, at which noise adds 1 to the variance of that log."""
NORMAL_QUARTILE = 0.6745
"""Upper quartile of the standard normal distribution."""
CHANCE_PRIOR = 0.1
"""Prior odds of being spurious for a pair with many transitions."""
CHANCE_TRANSITIONS = 3.0
"""Transitions at which these odds are doubled: chance makes few transitions of each pair."""
DEPARTURES_TO_TELL = 10.0
"""Scale of the departures of a zone that suffice to see whether anything follows them: of n
departures they suffice with probability ``1 - exp(-n / DEPARTURES_TO_TELL)``.
"""
REAL_MIN = 0.07
"""Least share of a pair's transitions that is taken as real, however weak the evidence."""


def spurious_shares(
    pair: Ints, responsibility: Floats, pairs: int, evidence: Floats, left: Floats
) -> Floats:
    """Return the spurious share (P,) of the transitions of each of ``pairs`` pairs of zones.

    pair, responsibility (M,): pair of zones and responsibility of each candidate.
    evidence (pairs with any, nats): evidence for a link (`cross_evidence`).
    left (zones,): departures of each zone.

    A pair without a transition of its own gets the probability that there is no link at all.
    """
    transitions: Floats = np.bincount(pair, responsibility, minlength=pairs).astype(float)
    each = evidence_against_unrelated(pair, responsibility, pairs) / np.maximum(transitions, 1e-300)
    real = np.where(transitions > 0, np.maximum(real_probability(each, transitions), REAL_MIN), 1.0)
    doubt: Floats = 1.0 - any_link_probability(evidence, left) * real
    return doubt


def real_probability(each: Floats, transitions: Floats) -> Floats:
    """Return the probability (P,) that a pair is a real path.

    each (P,): evidence per transition, nats.
    transitions (P,): number of transitions of each pair.

    The usual evidence is the median over the site's transitions. The spread among pairs is read off
    the upper half, as that holds no spurious ones.
    """
    if not transitions.any():
        return np.ones(len(each))

    # Median and upper quartile of the evidence per transition.
    order = np.argsort(each, kind="stable")
    reached = np.cumsum(transitions[order])
    half, upper = np.searchsorted(reached, (0.5 * reached[-1], 0.75 * reached[-1]))
    usual, high = (max(float(each[order[k]]), 1e-12) for k in (half, upper))

    # Likelihood of a real path: log-normal below the usual value, 1 above it.
    differ = (np.log(high / usual) / NORMAL_QUARTILE) ** 2 + SPREAD_MIN**2
    variance = differ + NATS_TO_TELL / np.maximum(usual * transitions, 1e-12)
    likely = np.exp(-0.5 * np.log(np.clip(each / usual, 1e-12, 1.0)) ** 2 / variance)

    # Posterior probability, scaled to 1 at the usual value.
    chance = CHANCE_PRIOR * (1.0 + CHANCE_TRANSITIONS / np.maximum(transitions, 1e-12))
    probability: Floats = (1.0 + chance) * likely / (likely + chance)
    return probability


def any_link_probability(evidence: Floats, left: Floats) -> float:
    """Return the probability that the site has any link, with prior probability 1/2.

    evidence (pairs with any, nats): evidence for a link.
    left (zones,): departures of each zone.

    The e-value of a pair without evidence is 0 if there were enough departures to find a link, and
    1 if there were not.
    """
    every = float(len(left)) ** 2
    unknown = float(np.exp(-left / DEPARTURES_TO_TELL).mean()) * (1.0 - len(evidence) / every)
    return float(
        expit(
            np.logaddexp(
                np.logaddexp.reduce(evidence) - np.log(every), np.log(max(unknown, 1e-300))
            )
        )
    )
