"""What is not known is not said to leave, where a path would not have been found."""

from __future__ import annotations

import numpy as np

from camtopod.predict.anywhere import missed_shares, surplus


def unknown(departures: float, leave: float, rate: float, cameras: int = 20) -> float:
    """Return the unknown share of one of 20 like zones."""
    departed, gone = np.full(20, departures), np.full(20, leave)
    missed = missed_shares(departed * gone, gone, np.full(20, rate), 180.0)
    assert np.ptp(missed) == 0.0
    return float(surplus(departed, gone, cameras) * missed[0])


def test_in_light_traffic_what_is_not_found_leaves() -> None:
    assert unknown(400.0, 0.9, 1e-4) < 0.01
    assert 0.5 < unknown(400.0, 0.9, 1.0) < 1.0 - 1.0 / 6.0 / 0.9


def test_more_departures_tell_more() -> None:
    shares = [unknown(n, 0.9, 0.02) for n in (10.0, 50.0, 250.0, 1250.0)]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > 2.0 * shares[-1]


def test_the_size_of_the_site_says_how_many_leave() -> None:
    shares = [unknown(30.0, 0.6, 0.1, cameras) for cameras in (1, 5, 20, 100)]
    assert shares == sorted(shares)
    # A site where fewer leave than usual is nearly, but never quite, sure of it.
    assert 0.0 < unknown(30.0, 0.05, 1.0, 4) <= 0.05


def test_a_site_without_departures_or_arrivals_has_figures() -> None:
    none = np.zeros(20)
    assert np.isfinite(surplus(none, none + 1.0, 20))
    assert np.isfinite(missed_shares(none, none + 1.0, none, 180.0)).all()
