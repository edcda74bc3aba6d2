"""Change points of shares: found early, rarely false, and their effect on links."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from camtopod.arrays import Floats
from camtopod.learn.changes import change_points
from camtopod.learn.changes.change_points import (
    ChangePoint,
    Trials,
    latest_change,
    present,
    threshold_nats,
)
from camtopod.learn.links.link_table import LinkTable, Transitions, tabulate
from camtopod.learn.links.publishing import PublishingRule
from camtopod.learn.settings import Settings
from camtopod.topology.lag_bins import LagBins

SURE = 0.95
RULE = PublishingRule(Settings(publish_probability_min=0.03))
THRESHOLD = threshold_nats(100, 10_000)
"""As for a network of a hundred pairs of zones and ten thousand departures."""


def trials(
    share: Floats, seed: int, weight: Floats | None = None, times: Floats | None = None
) -> Trials:
    """Return departures a minute apart that take the path with these probabilities."""
    chance = np.random.default_rng(seed)
    t: Floats = 60.0 * np.arange(len(share)) if times is None else times
    moved = t[chance.random(len(share)) < share]
    return Trials(
        t, np.ones(len(t)) if weight is None else weight, moved, np.full(len(moved), SURE)
    )


def two(before: float, after: float, n: int, late: int) -> Floats:
    """Return shares of n departures of which the last ``late`` follow the change."""
    return np.where(np.arange(n) < n - late, before, after)


# --- finding them ---


@pytest.mark.parametrize("seed", range(5))
def test_a_closed_way_is_known_after_fifteen_passages(seed: int) -> None:
    found = latest_change(trials(two(0.5, 0.0, 400, 30), seed), THRESHOLD)
    assert found is not None
    since, before, after, _ = found
    assert (370 - 10) * 60 <= since <= (370 + 2) * 60
    assert before == pytest.approx(0.5, abs=0.1)
    assert after < 0.02


@pytest.mark.parametrize("seed", range(5))
def test_an_opened_way_is_known_after_ten_passages(seed: int) -> None:
    found = latest_change(trials(two(0.0, 0.5, 400, 20), seed), THRESHOLD)
    assert found is not None
    since, before, after, _ = found
    assert 379 * 60 <= since <= 386 * 60
    assert before < 0.01
    assert after == pytest.approx(0.5, abs=0.25)


def test_of_two_changes_the_last_counts() -> None:
    shares = np.concatenate((np.full(200, 0.4), np.zeros(200), np.full(200, 0.7)))
    found = latest_change(trials(shares, 1), THRESHOLD)
    assert found is not None
    since, before, after, _ = found
    assert since == pytest.approx(400 * 60, abs=600)
    assert before < 0.02
    assert after == pytest.approx(0.7, abs=0.1)


def test_nothing_is_found_where_nothing_changes() -> None:
    low = threshold_nats(1, 400)  # a single series: as sensitive as it gets
    found = [latest_change(trials(np.full(400, 0.3), seed), low) for seed in range(300)]
    assert sum(change is not None for change in found) <= 2


def test_a_share_that_follows_the_hour_is_no_change() -> None:
    hour = np.arange(2400) % 240 / 10
    shares = 0.4 + 0.3 * np.sin(2 * np.pi * hour / 24)
    assert latest_change(trials(shares, 5), THRESHOLD) is None
    assert (
        latest_change(trials(shares[:240], 5), THRESHOLD) is not None
    )  # a single day looks like one


def test_arrivals_that_come_from_elsewhere_do_not_keep_a_way_open() -> None:
    chance = np.random.default_rng(6)
    walked = trials(two(0.5, 0.0, 400, 60), 6)
    others = np.sort(chance.uniform(340 * 60, 400 * 60, 60))
    order = np.argsort(np.concatenate((walked.departure_t, others)), kind="stable")
    moved = np.concatenate((walked.departure_t, others))[order]
    share = np.concatenate((walked.share, np.full(60, 0.2)))[order]
    found = latest_change(Trials(walked.t, walked.weight, moved, share), THRESHOLD)
    assert found is not None
    assert found[2] < 0.03


def slow_gain(given: Trials) -> float:
    """Return the best gain over every split, with factors by numerical search."""

    def best(begin: int, end: int) -> float:
        t0, t1 = given.t[begin], given.t[end] if end < len(given.t) else np.inf
        share = given.share[(given.departure_t >= t0) & (given.departure_t < t1)]
        expected = rate * given.weight[begin:end].sum()

        def loss(factor: float) -> float:
            return float((factor - 1) * expected - np.log1p((factor - 1) * share).sum())

        return -min(minimize_scalar(loss, bounds=(0.0, 1 / rate), method="bounded").fun, loss(0.0))

    n = len(given.t)
    rate = given.share.sum() / given.weight.sum()
    return float(max(best(0, k) + best(k, n) for k in range(4, n - 3)) - best(0, n))


@pytest.mark.parametrize("seed", range(4))
def test_the_quick_search_finds_what_the_slow_one_does(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(change_points, "PARTS", 2)  # no overdispersion, which has no slow twin
    given = trials(two(0.6, 0.1 * seed, 120, 40), seed)
    slow = slow_gain(given)
    found = latest_change(given, 0.7 * slow)
    assert found is not None
    assert found[3] == pytest.approx(slow, rel=0.1, abs=0.7)  # as coarse as the factors


# --- what they do to the links ---

BINS = LagBins(-20.0, 120.0)


def table(rows: list[tuple[int, int, int]], leaving: float = 100.0) -> LinkTable:
    """Return links (source, target, transitions) of four zones."""
    columns = [
        np.repeat([row[k] for row in rows], [row[2] for row in rows]).astype(np.int32)
        for k in (0, 1)
    ]
    n = len(columns[0])
    moved = Transitions(columns[0], columns[1], np.full(n, 9.0), np.ones(n), np.zeros(n))
    return tabulate(moved, np.full((4, 1), leaving), BINS, 4)


def test_a_closed_link_is_left_out_and_others_stay() -> None:
    links = present(
        table([(0, 1, 50), (0, 2, 20)]), [ChangePoint(0, 1, 5.0, 0.8, 0.0, 30.0)], 4, RULE
    )
    assert links.target.tolist() == [2]
    assert links.probability.tolist() == [0.2]


def test_an_opened_link_has_its_present_share_and_its_own_evidence() -> None:
    links = table([(0, 1, 5), (2, 3, 60)]).with_evidence(np.array([3.0, 50.0]), 16)
    links = present(links, [ChangePoint(0, 1, 5.0, 0.0, 0.5, 20.0, link_nats=18.0)], 4, RULE)
    assert links.probability.tolist() == [0.5, 0.6]
    assert links.ratio.tolist() == [18.0, 50.0]
    assert links.q[0] < 1e-6


def test_shares_beside_a_new_one_make_no_more_than_one() -> None:
    links = present(
        table([(0, 1, 10), (0, 2, 90), (3, 2, 95)]),
        [ChangePoint(0, 1, 5.0, 0.0, 0.6, 20.0)],
        4,
        RULE,
    )
    assert links.probability.tolist() == pytest.approx([0.6, 0.4, 0.95])
