"""The sum-product approximation of the marginals of a one-to-one assignment (METHOD 5).

M candidates compete for departures, each of which causes at most one arrival, and for arrivals,
each of which has one cause (Williams and Lau, IEEE Trans. AES 50(4), 2014). One sweep computes the
offers of departures (`offers`), from which the caller sums up the demand for each arrival, then the
answers of arrivals (`answers`). The messages of a sweep go into the next one.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, Indices, Singles

DEMAND_MIN = 1e-12
"""Lower bound on the rates that compete for an arrival, 1/s."""


def offers(
    rate: Floats | Singles, message: Floats | Singles, departure: Indices, none: Floats
) -> Floats:
    """Return the offer of each candidate: its rate if its departure causes no other arrival, (M,).

    rate (M, 1/s): rate at which the departure of each candidate would cause its arrival.
    message (M, s): messages from arrivals; at first, 1 over the demand without any candidate.
    departure (M,): row of the departure of each candidate.
    none (n,): probability that each departure causes no arrival; above 0.
    """
    # In double precision, as differences of nearly equal numbers matter.
    asked = rate * message
    taken = np.bincount(departure, asked, minlength=len(none)) + none
    offer: Floats = rate / (taken.take(departure) - asked)
    return offer


def answers(offer: Floats, demand: Floats) -> tuple[Floats, Floats]:
    """Return the responsibility of each candidate, and the message from its arrival, (M,) each.

    offer (M, 1/s): the offers.
    demand (M, 1/s): sum of all offers to the candidate's arrival and of its rate from outside.

    The responsibility is the offer's share; the message is 1 over the rest, seconds.
    """
    return offer / demand, 1.0 / np.maximum(demand - offer, DEMAND_MIN)
