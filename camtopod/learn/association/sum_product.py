"""The sum-product approximation of the marginals of a one-to-one assignment (METHOD 5).

M candidates compete for departures, each of which causes at most one arrival, and for arrivals,
each of which has one cause (Williams and Lau, IEEE Trans. AES 50(4), 2014). One sweep sums up the
`claims` on departures, then the `offers` of departures, and computes the `answers` of arrivals,
whose messages make the claims of the next sweep.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, Indices, Singles

DEMAND_MIN = 1e-12
"""Lower bound on the rates that compete for an arrival, 1/s."""


def claims(
    rate: Floats | Singles, message: Floats | Singles, departure: Indices, no_arrival: Floats
) -> Floats:
    """Return the sum of the claims on each departure, and of that of no arrival, (n,).

    rate (M, 1/s): rate at which the departure of each candidate would cause its arrival.
    message (M, s): messages from arrivals; at first, 1 over the demand without any candidate.
    departure (M,): row of the departure of each candidate.
    no_arrival (n,): probability that each departure causes no arrival; above 0.
    """
    return np.bincount(departure, rate * message, minlength=len(no_arrival)) + no_arrival


def offers(
    rate: Floats | Singles, message: Floats | Singles, departure: Indices, claim_sums: Floats
) -> Floats:
    """Return the offer of each candidate: its rate if its departure causes no other arrival, (M,).

    The arguments are as for `claims`, of which ``claim_sums`` (n,) is the result.
    """
    # In double precision, as differences of nearly equal numbers matter.
    return rate / (claim_sums.take(departure) - rate * message)


def answers(offer: Floats, demand: Floats) -> tuple[Floats, Floats]:
    """Return the responsibility of each candidate, and the message from its arrival, (M,) each.

    offer (M, 1/s): the offers.
    demand (M, 1/s): sum of all offers to the candidate's arrival and of its rate from outside.

    The responsibility is the offer's share; the message is 1 over the rest, seconds.
    """
    return offer / demand, 1.0 / np.maximum(demand - offer, DEMAND_MIN)
