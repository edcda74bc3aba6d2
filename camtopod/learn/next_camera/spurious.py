"""How far what is believed of two zones may be chance.

Among thousands of pairs of zones chance makes a few transitions for each. Together they would be
many: an object that is not seen again would as a rule be foretold somewhere. One at a time they
cannot be told from a rare way, but they are out of character. The transitions of a way that is
taken add about as much to the likelihood as those of the site's other ways: much where few are
under way at once and transit times are kept closely, little in a crowd. Those made by chance add
far less. So each pair's *evidence per transition* is held against what is usual on this site, as
far as the site's pairs are alike and so many transitions would have been enough to tell. It is no
matter of how broad a pair's transit times are: where all are broad, that is usual.

Where no pair of zones is beyond chance, what is usual says nothing. Whether anything is linked at
all is asked of all pairs at once: the mean of the e-values of all the pairs that there could be is
one, too (see `crossfit`).
"""

from __future__ import annotations

import numpy as np
from scipy.special import expit

from camtopod.arrays import Floats, Ints
from camtopod.learn.links import unrelated

SPREAD_MIN = 0.7
"""Standard deviation of the log of the evidence per transition among the ways of any site, at
least.
"""
NATS_TO_TELL = 3.0
"""Where a way with so many transitions would have this much evidence, chance adds 1 to the variance
of its log.
"""
NORMAL_QUARTILE = 0.6745
CHANCE_PRIOR = 0.1
"""How likely a pair of many transitions is one that chance made, beside a way whose evidence is the
usual; ...
"""
CHANCE_TRANSITIONS = 3.0
"""... one of so many is twice as likely, as chance makes few of each."""
DEPARTURES_TO_TELL = 10.0
"""Of so many departures of a zone two in three would do to see that nothing follows them
anywhere.
"""
REAL_MIN = 0.07
"""Share of the transitions that are real even where all speaks against it."""


def doubts(
    pair: Ints, responsibility: Floats, pairs: int, evidence: Floats, left: Floats
) -> Floats:
    """Share (P,) of the transitions of each of ``pairs`` pairs of zones that may as well be chance.

    ``pair``, ``responsibility`` (M,): of the candidates; ``evidence``: in nats, of pairs of zones
    (`cross_evidence`); ``left`` (zones,): departures. Without a transition of its own a pair is as
    doubtful as it is whether anything is linked.
    """
    transitions: Floats = np.bincount(pair, responsibility, minlength=pairs).astype(float)
    each = unrelated(pair, responsibility, pairs) / np.maximum(transitions, 1e-300)
    real = np.where(transitions > 0, np.maximum(in_character(each, transitions), REAL_MIN), 1.0)
    doubt: Floats = 1.0 - linked(evidence, left) * real
    return doubt


def in_character(each: Floats, transitions: Floats) -> Floats:
    """Probability (P,) that a pair is a way and not chance, by its evidence ``each`` transition
    (P,), nats.

    Half of the site's transitions have more than the usual; how far pairs differ is read off those,
    as chance is not among them.
    """
    if not transitions.any():
        return np.ones(len(each))
    order = np.argsort(each, kind="stable")
    reached = np.cumsum(transitions[order])
    half, upper = np.searchsorted(reached, (0.5 * reached[-1], 0.75 * reached[-1]))
    usual, high = (max(float(each[order[k]]), 1e-12) for k in (half, upper))
    differ = (np.log(high / usual) / NORMAL_QUARTILE) ** 2 + SPREAD_MIN**2
    variance = differ + NATS_TO_TELL / np.maximum(usual * transitions, 1e-12)
    likely = np.exp(-0.5 * np.log(np.clip(each / usual, 1e-12, 1.0)) ** 2 / variance)
    chance = CHANCE_PRIOR * (1.0 + CHANCE_TRANSITIONS / np.maximum(transitions, 1e-12))
    probability: Floats = (1.0 + chance) * likely / (likely + chance)
    return probability


def linked(evidence: Floats, left: Floats) -> float:
    """Probability that any of the zones are linked, as likely as not beforehand: by the evidence
    (nats) of those pairs that have any, and by the ``left`` (zones,) departures.

    The others' e-values are 0 where departures would have been enough to find something, and 1
    where they were not.
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
