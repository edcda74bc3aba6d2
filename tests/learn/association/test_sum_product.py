"""Sum-product messages are exact where no two candidates close a cycle, as by enumeration."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from camtopod.learn.association import answers, claims, offers


def test_responsibilities_on_a_chain_are_exact() -> None:
    # Departure 0 - arrival 0 - departure 1 - arrival 1 - departure 2.
    departure, arrival = np.array([0, 1, 1, 2]), np.array([0, 0, 1, 1])
    rate, none, background = np.array([0.3, 0.2, 0.5, 0.1]), np.array([0.4, 0.3, 0.9]), [0.2, 0.05]
    message = 1.0 / np.array(background)[arrival]
    for _ in range(4):
        offer = offers(rate, message, departure, claims(rate, message, departure, none))
        demand = background + np.bincount(arrival, offer)
        responsibility, message = answers(offer, demand[arrival])

    total, exact = 0.0, np.zeros(4)
    for chosen in itertools.product((False, True), repeat=4):
        mask = np.array(chosen)
        left, came = departure[mask], arrival[mask]
        if len(set(left)) < len(left) or len(set(came)) < len(came):
            continue
        odds = rate[mask].prod() * np.delete(none, left).prod() * np.delete(background, came).prod()
        total += odds
        exact[mask] += odds
    assert responsibility == pytest.approx(exact / total)
