"""Significance of pairs of zones: the evidence for a link, and the false discovery rate it implies.

The evidence for a pair of zones is the log likelihood ratio between the joint fit with and without
the pair. As the fit leaves every arrival out of its own prediction, the ratio measures prediction,
not fit: under the null model ``P(ratio > x)`` is at most about ``exp(-x)``, whatever the shape of
the lag histogram. These p-values are turned into false discovery rates (Benjamini and Hochberg
1995).
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, Ints, Longs, Rows
from camtopod.learn.association import RESPONSIBILITY_MAX

PARTS = 32
"""Parts of the window with as many events each; two in a row are taken for one occasion. There
are half as many on either side of a change, whose counts tell the overdispersion.
"""
OCCASION_SHARE_MAX = 1.0 / 3.0
"""Evidence of one occasion that counts, as a share of that of all others."""


def log_likelihood_ratio(
    pair: Ints | Rows, responsibility: Floats, flat: Floats, pairs: int
) -> Floats:
    """Return the evidence (P, nats) that the zones of each pair are linked.

    The evidence is a log likelihood ratio against two null models, of which the stronger one counts
    (the smaller ratio): the zones are unrelated; or arrivals at one zone follow departures from the
    other at no particular lag, as when both zones follow a rhythm.

    pair (M,): pair of zones of each candidate.
    responsibility (M,): of each candidate.
    flat (M,): hazard of the candidate's pair if it were the same at all lags (the second null
        model), over the hazard at its lag.
    pairs: number of pairs, P.
    """
    against_unrelated = evidence_against_unrelated(pair, responsibility, pairs)
    return np.minimum(
        against_unrelated, evidence_against_untimed(pair, responsibility, flat, pairs)
    )


def evidence_against_untimed(
    pair: Ints | Rows, responsibility: Floats, flat: Floats, pairs: int
) -> Floats:
    """Return the evidence (P, nats) of each pair of zones against transitions at no particular lag.

    Arguments are as for `log_likelihood_ratio`.
    """
    share = np.minimum(responsibility, RESPONSIBILITY_MAX)
    flat = np.minimum(flat, 1.0 / (1.0 - RESPONSIBILITY_MAX))  # as far as evidence for a link goes
    nats = -np.log1p(share * (flat - 1.0))
    return np.bincount(pair, nats, minlength=pairs).astype(float)


def evidence_against_unrelated(pair: Ints | Rows, responsibility: Floats, pairs: int) -> Floats:
    """Return the evidence (P, nats) of each pair of zones against the zones being unrelated.

    Arguments are as for `log_likelihood_ratio`.
    """
    share = np.minimum(responsibility, RESPONSIBILITY_MAX)
    evidence: Floats = np.bincount(pair, -np.log1p(-share) - share, minlength=pairs).astype(float)
    return evidence


def repeated_evidence(
    pair: Ints | Rows,
    responsibility: Floats,
    flat: Floats,
    at: Floats,
    pairs: int,
    expected: Floats | None = None,
) -> Floats:
    """Return the evidence (P, nats) of each pair of zones that does not rest on one occasion.

    at (M,): the share of the window's arrivals that came before each candidate, 0 to 1.
    expected (P, PARTS): transitions of each pair that the departures in each part of the window
        make expect (`expected_by_part`); None for those that come, as where the hazards have been
        learned without the candidate itself.

    A group of people that walks together makes as many transitions of one lag as it has members,
    once (`repeated`): at all other times, fewer come than are expected. Other arguments are as for
    `log_likelihood_ratio`.
    """
    cell = pair * PARTS + _part(at)
    share = np.minimum(responsibility, RESPONSIBILITY_MAX)
    nats_by_part, transitions_by_part = (
        np.bincount(cell, weight, pairs * PARTS).astype(float).reshape(pairs, PARTS)
        for weight in (-np.log1p(-share), share)
    )
    against_untimed = evidence_against_untimed(cell, responsibility, flat, pairs * PARTS)
    against_unrelated = nats_by_part - (transitions_by_part if expected is None else expected)
    nats = np.stack((against_unrelated, against_untimed.reshape(pairs, PARTS)))
    evidence: Floats = repeated(nats).min(axis=0)
    return evidence


def expected_by_part(transitions: Floats, source: Ints | Rows, zone: Ints, at: Floats) -> Floats:
    """Return the expected transitions of each pair of zones by part of the window, (P, PARTS).

    transitions (P,): expected transitions of each pair. source (P,): its zone of departure.
    zone (n,), at (n,): zone of each departure, and the share of the departures before it.
    """
    zones = int(max(zone.max(initial=0), source.max(initial=0))) + 1
    cell = zone.astype(np.int64) * PARTS + _part(at)
    departures = np.bincount(cell, minlength=zones * PARTS).reshape(zones, PARTS)
    share = departures / np.maximum(departures.sum(axis=1, keepdims=True), 1)
    expected: Floats = transitions[:, None] * share[source]
    return expected


def _part(at: Floats) -> Longs:
    """Return the number of the part of the window of each place (n,), a share of the events."""
    return np.clip((at * PARTS).astype(np.int64), 0, PARTS - 1)


def repeated(nats: Floats) -> Floats:
    """Return the total (P,) of evidence by parts of the window (P, PARTS), less what is told once.

    The sixteenth of the events that speaks most for a pair counts no more than a third of the rest.
    """
    total = nats.sum(axis=-1)
    remainder = total - np.maximum((nats[..., :-1] + nats[..., 1:]).max(axis=-1), 0.0)
    evidence: Floats = np.minimum(total, (1.0 + OCCASION_SHARE_MAX) * remainder)
    return evidence


def q_values(ratio: Floats, tests: int, weight: Floats | float = 1.0) -> Floats:
    """Return the false discovery rate (P,) at which each pair of zones would be published.

    ratio (P,): evidence for each pair, nats.
    tests: number of pairs of zones that were tested.
    weight (P,): weight of each pair; the mean over all that were tested is 1, and it is fixed
        before the events are seen (Genovese, Roeder, Wasserman, Biometrika 93(3), 2006).
    """
    # Benjamini-Hochberg: p / weight * tests / rank, made monotone from the largest down.
    p = np.exp(-np.maximum(ratio + np.log(weight), 0.0))
    order = np.argsort(p, kind="stable")
    ratios = p[order] * max(tests, 1) / np.arange(1, len(p) + 1)
    q = np.empty(len(p))
    q[order] = np.minimum(np.minimum.accumulate(ratios[::-1])[::-1], 1.0)
    return q


def ratio_needed(rank: int, tests: int, q_max: float) -> float:
    """Return the evidence, in nats, that a pair of zones needs for a given false discovery rate.

    It is that of a pair with a weight of 1; others need less by the logarithm of their weight.

    rank: rank of the pair by evidence, from 1 for the largest.
    tests: number of pairs of zones that were tested.
    q_max: the false discovery rate that is allowed.
    """
    return float(np.log(max(tests, 1) / (max(q_max, 1e-300) * rank)))
