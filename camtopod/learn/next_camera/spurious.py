"""Estimate the share of the transitions of each pair of zones that is spurious, made by chance.

Among thousands of pairs of zones, chance makes a few transitions for each. They contribute far less
evidence than transitions on the real paths of the site, which contribute about equally much. So
`real_probability` compares each pair's *evidence per transition* with the site's usual value,
allowing for the spread among pairs and for pairs with few transitions. A path of widely spread
transit times through heavy traffic has little evidence per transition, too, but many transitions:
its held-out evidence (`links.cross_validation`) makes up for it.

Where no pair of zones has significant evidence, the usual value has no meaning. So
`any_link_probability` estimates from all pairs together whether the site has any link at all: the
mean of the e-values of all possible pairs is an e-value, too (see `links.cross_validation`).
"""

from __future__ import annotations

import numpy as np
from scipy.special import expit

from camtopod.arrays import Bools, Floats, Ints
from camtopod.learn.links import evidence_against_unrelated

SPREAD = 0.7
"""Standard deviation, among real paths, of the log of the evidence per transition."""
NATS_TO_TELL = 3.0
"""Usual evidence of a pair's transitions, in nats, at which noise adds 1 to the variance of the log
of its evidence per transition.
"""
CHANCE_PRIOR = 0.1
"""Prior odds of being spurious."""
RETURN_SHARE = 0.15
"""How likely a path that leads back into the same view is, compared with one into another."""
DEPARTURES_TO_TELL = 10.0
"""Scale of the number of departures of a zone that are enough to find a link from there. n
departures are enough with probability ``1 - exp(-n / DEPARTURES_TO_TELL)``.
"""


def spurious_shares(
    pair: Ints,
    responsibility: Floats,
    evidence: Floats,
    any_link: float,
    returns: Bools,
    chance: Floats | float = CHANCE_PRIOR,
) -> Floats:
    """Return the spurious share of the transitions of each pair of zones, (P,).

    pair, responsibility (M,): pair of zones and responsibility of each candidate.
    evidence (P, nats): held-out evidence of each pair (`link_evidence`); 0 if there is none.
    any_link: probability that the site has any link at all (`any_link_probability`).
    returns (P,): True for the pairs that lead back into the same view.
    chance (P,): prior odds of being spurious.

    A pair without a transition gets the probability that the site has no link at all.
    """
    pairs = len(evidence)
    transitions: Floats = np.bincount(pair, responsibility, minlength=pairs).astype(float)
    nats_per_transition = evidence_against_unrelated(pair, responsibility, pairs) / np.maximum(
        transitions, 1e-300
    )
    real = real_probability(nats_per_transition, transitions, evidence, returns, chance)
    real = np.where(transitions > 0, real, 1.0)
    doubt: Floats = 1.0 - any_link * real
    return doubt


def real_probability(
    nats_per_transition: Floats,
    transitions: Floats,
    evidence: Floats,
    returns: Bools,
    chance: Floats | float = CHANCE_PRIOR,
) -> Floats:
    """Return the probability (P,) that the transitions of each pair of zones are real.

    nats_per_transition (P,): evidence per transition of each pair, nats.
    transitions (P,): number of transitions of each pair.
    evidence (P,): held-out evidence of each pair, nats.
    returns (P,), chance (P,): as for `spurious_shares`.

    The usual evidence per transition is the median over the site's transitions.
    """
    if not transitions.any():
        return np.ones(len(nats_per_transition))

    # Median of the evidence per transition.
    order = np.argsort(nats_per_transition, kind="stable")
    cumulative = np.cumsum(transitions[order])
    usual = max(
        float(nats_per_transition[order[np.searchsorted(cumulative, 0.5 * cumulative[-1])]]), 1e-12
    )

    # Likelihood of a real path: log-normal below the usual value, 1 above it. Held-out evidence
    # multiplies it, up to 1.
    variance = SPREAD**2 + NATS_TO_TELL / np.maximum(usual * transitions, 1e-12)
    nats = -0.5 * np.log(np.clip(nats_per_transition / usual, 1e-12, 1.0)) ** 2 / variance
    held_out = np.maximum(evidence, 0.0)
    likely = np.exp(np.minimum(nats + held_out, 0.0))
    rare = np.exp(np.minimum(np.log(RETURN_SHARE) + held_out, 0.0))
    likely = np.where(returns, likely * rare, likely)

    # Posterior probability, scaled to 1 at the usual value.
    probability: Floats = (1.0 + chance) * likely / (likely + chance)
    return probability


def any_link_probability(evidence: Floats, departures: Floats) -> float:
    """Return the probability that the site has any link, with prior probability 1/2.

    evidence (k, nats): evidence of the k pairs of zones that have any.
    departures (zones,): number of departures of each zone.

    The e-value of a pair without evidence is 0 if there were enough departures to find a link, and
    1 if there were not.
    """
    pair_count = float(len(departures)) ** 2
    unknown = float(np.exp(-departures / DEPARTURES_TO_TELL).mean()) * (
        1.0 - len(evidence) / pair_count
    )
    return float(
        expit(
            np.logaddexp(
                np.logaddexp.reduce(evidence) - np.log(pair_count), np.log(max(unknown, 1e-300))
            )
        )
    )
