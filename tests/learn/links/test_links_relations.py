"""Figures of links, their publication, weak links, relations of camera pairs, the chain."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given, strategies as st
from synthetic_events import Views

from camtopod.learn.links.link_table import (
    FAINT_TRANSITIONS,
    NEXT_ZONES_MAX,
    TRANSITIONS_MIN,
    LinkTable,
    Transitions,
    exposed_departures,
    select_weak_links,
    tabulate,
)
from camtopod.learn.links.publishing import PublishingRule
from camtopod.learn.settings import Settings
from camtopod.markov_chain import estimate_markov_chain
from camtopod.records import Link, Transit, Zone
from camtopod.topology.camera_pairs import find_camera_pairs, sum_rule
from camtopod.topology.lag_bins import LagBins

BINS = LagBins(-20.0, 120.0)
RULE = PublishingRule(Settings(publish_q_max=0.01, publish_probability_min=0.03))


def transitions(*rows: tuple[int, int, float, float]) -> Transitions:
    """Return transitions (source, target, lag, weight)."""
    source, target, lag, weight = (np.array(column) for column in zip(*rows, strict=True))
    return Transitions(
        source.astype(np.int32), target.astype(np.int32), lag, weight, np.full(len(lag), 1e-3)
    )


def repeated(
    source: int, target: int, lag: float, n: int, weight: float = 0.999
) -> list[tuple[int, int, float, float]]:
    return [(source, target, lag + 0.1 * (k % 5 - 2), weight) for k in range(n)]


# --- tables ---


@given(st.integers(0, 10**6), st.integers(0, 60), st.integers(1, 4))
def test_table_has_every_pair_once_with_its_figures(seed: int, n: int, zones: int) -> None:
    rng = np.random.default_rng(seed)
    source, target = rng.integers(0, zones, (2, n)).astype(np.int32)
    t = Transitions(source, target, rng.uniform(-25, 130, n), rng.random(n), np.ones(n))
    left = rng.integers(0, 30, (zones, BINS.size)).astype(float)
    at = BINS.index(t.lag)
    table = tabulate(t, left, BINS, zones)
    pairs = sorted(set(zip(source.tolist(), target.tolist(), strict=True)))
    assert list(zip(table.source.tolist(), table.target.tolist(), strict=True)) == pairs
    for row, (u, v) in enumerate(pairs):
        own = (source == u) & (target == v)
        total = t.weight[own].sum()
        assert table.transit.total[row] == pytest.approx(total)
        seen = sum(
            w / max(left[u, k], 1.0) for w, k in zip(t.weight[own], at[own], strict=True) if k >= 0
        )
        assert table.probability[row] == pytest.approx(min(seen, 1.0))
        counts = np.zeros(BINS.size)
        for lag, weight in zip(t.lag[own], t.weight[own], strict=True):
            k = naive.lag_bin(lag, BINS.lag_min, BINS.lag_max, BINS.scale, BINS.step)
            counts[k] += weight * (k >= 0)
        assert table.counts[row] == pytest.approx(counts)
    assert table.q == pytest.approx(
        naive.q_values(np.minimum(np.exp(-table.ratio), 1.0), max(len(pairs), 1))
    )
    back = table.rows(np.arange(len(pairs))[::-1])
    assert back.source.tolist() == table.source[::-1].tolist()
    assert back.transit.mode == pytest.approx(table.transit.mode[::-1], nan_ok=True)
    assert (back.counts == table.counts[::-1]).all()


def test_who_may_still_be_on_the_way_does_not_lower_the_share() -> None:
    """Everybody takes 60 s to the next view; half have left in the last minute."""
    views = Views([0, 1])
    for k in range(40):
        views.through(3.0 * k, 3.0 * k + 1.0, 0, 0)
    exposed = exposed_departures(views.problem(BINS)._replace(until=121.0))
    arrived = transitions(*repeated(0, 1, 60.0, 20))
    table = tabulate(arrived, exposed, BINS, 2)
    assert table.probability[0] == pytest.approx(1.0, abs=0.1)
    ahead = tabulate(transitions(*repeated(0, 1, -3.0, 20)), exposed, BINS, 2)
    assert ahead.probability[0] == pytest.approx(
        0.5, abs=0.01
    )  # what comes before the exit is over by then


# --- what is published ---


def published(*rows: tuple[int, int, float, float], left: float = 100.0) -> list[tuple[int, int]]:
    table = tabulate(transitions(*rows), np.full((5, 1), left), BINS, 5)
    return [
        (int(table.source[k]), int(table.target[k]))
        for k in np.flatnonzero(RULE.judge(table).published)
    ]


def test_a_link_needs_evidence_share_and_number() -> None:
    assert published(*repeated(0, 1, 8.0, 50)) == [(0, 1)]
    assert published(*repeated(0, 1, 8.0, 50, weight=0.05)) == []  # hardly any evidence
    assert published(*repeated(0, 1, 8.0, 50), left=5000.0) == []  # 1 % of those who leave
    assert published(*repeated(0, 1, 8.0, 1)) == []
    assert TRANSITIONS_MIN > 1


def test_the_thesiss_variance_counts_too() -> None:
    """Lags at both ends of the range vary more than under the null model."""
    table = tabulate(
        transitions(*repeated(0, 1, -19.0, 50), *repeated(0, 1, 119.0, 50)),
        np.full((2, 1), 100.0),
        BINS,
        2,
    )
    assert table.variance[0] > 1
    verdict = RULE.judge(table)
    assert (verdict.q & verdict.probability & verdict.transitions).all()
    assert not verdict.variance.any()
    assert not verdict.published.any()


# --- weak links ---


def weak_and_strong(seed: int) -> tuple[LinkTable, LinkTable, LinkTable]:
    """Return a posterior over 40 zones, its published rows, and the weak links."""
    rng = np.random.default_rng(seed)
    rows = [(0, v, 5.0, w) for v, w in enumerate(rng.exponential(1.0, 40))]
    rows += [(1, v, 5.0, 0.01) for v in range(5)] + [(2, 3, 5.0, 6.0)]
    likely = tabulate(transitions(*rows), np.full((40, 1), 60.0), BINS, 40)
    strong = likely.rows(np.flatnonzero(rng.random(len(rows)) < 0.1))
    strong = strong._replace(probability=np.minimum(1.2 * strong.probability, 1.0))
    return likely, strong, select_weak_links(likely, strong, 40)


@pytest.mark.parametrize("seed", range(5))
def test_weak_links_are_the_likeliest_of_the_rest(seed: int) -> None:
    likely, strong, weak = weak_and_strong(seed)
    done = set(zip(strong.source.tolist(), strong.target.tolist(), strict=True))
    for zone in range(3):
        rest = [
            (-likely.probability[k], int(likely.target[k]))
            for k in range(len(likely.source))
            if likely.source[k] == zone
            and (zone, int(likely.target[k])) not in done
            and likely.transit.total[k] >= FAINT_TRANSITIONS
        ]
        found = weak.target[weak.source == zone].tolist()
        assert found == [target for _, target in sorted(rest)][:NEXT_ZONES_MAX]


@pytest.mark.parametrize("seed", range(5))
def test_weak_links_share_what_the_published_leave_over(seed: int) -> None:
    likely, strong, weak = weak_and_strong(seed)
    taken = sum(strong.probability[strong.source == 0])
    before = sum(
        p
        for u, v, p in zip(likely.source, likely.target, likely.probability, strict=True)
        if u == 0 and v in strong.target[strong.source == 0]
    )
    rows = weak.source == 0
    for v, p in zip(weak.target[rows], weak.probability[rows], strict=True):
        own = likely.probability[(likely.source == 0) & (likely.target == v)][0]
        assert p == pytest.approx(own * (1 - taken) / (1 - before))
    assert taken + weak.probability[weak.source == 0].sum() <= 1.0 + 1e-9


# --- relations ---


@pytest.mark.parametrize(
    ("ab", "ac", "cb", "tolerance", "holds"),
    [
        (10.5, 2.3, 8.25, 0.2, True),  # table 5.3
        (5.1, 0.991, 3.95, 0.2, True),
        (4.9167, 3.9, 0.991, 0.2, True),
        (13.0, 9.9, 2.85, 0.45, True),  # table 5.4
        (4.45, 1.6, 3.3, 0.45, True),  # exactly 0.45
        (10.65, 3.7, 7.55, 0.45, False),  # the row its own figures contradict
        (10.5, 2.3, 8.25, 0.04, False),
    ],
)
def test_sum_rule(ab: float, ac: float, cb: float, tolerance: float, holds: bool) -> None:
    assert sum_rule(ab, ac, cb, tolerance) is holds


def link(from_: str, to: str, relation: str, median: float, probability: float = 0.5) -> Link:
    transit = Transit(median, median, 1.0, median - 1, median, median + 1)
    return Link(from_, to, relation, probability, 10.0, transit, 0.0, 0.1)  # type: ignore[arg-type]


def zone(name: str, exits: int = 10) -> Zone:
    return Zone(name, name.split("/")[0], 10, exits)


ZONES = [zone(name) for name in ("a/1", "a/2", "b/1", "b/2", "c/1")]


def related(links: list[Link], tolerance: float = 0.2) -> list[tuple[str, ...]]:
    """Return cameras, relation, verdict by lags, verdict by the sum rule ("": not tested)."""
    pairs = find_camera_pairs(ZONES, links, tolerance)
    for pair in pairs:
        assert (pair.reason is None) == (pair.by_lags == pair.by_sum_rule)
    return [("".join(p.cameras), p.relation, p.by_lags or "", p.by_sum_rule or "") for p in pairs]


def test_pairs_of_cameras_once_each_sorted() -> None:
    links = [
        link("b/1", "a/1", "unseen", 8.0),
        link("a/1", "b/1", "unseen", 8.0),
        link("c/1", "a/1", "overlapped", -2.0),
        link("a/1", "a/2", "unseen", 30.0),  # comes back
    ]
    assert related(links) == [
        ("ab", "unseen_path", "unseen_path", ""),
        ("ac", "overlapped", "overlapped", ""),
    ]
    assert find_camera_pairs(ZONES, [], 0.2) == []
    assert find_camera_pairs(ZONES, [link("a/1", "a/2", "visible", 5.0)], 0.2) == []


def test_both_verdicts_and_why_they_differ() -> None:
    """Half of the lags of the first are negative, so the lags alone say unseen; the passage of 6 s
    decides.
    """
    inside, after = link("a/2", "b/1", "unseen", -0.5), link("a/2", "b/1", "unseen", 0.5)
    ahead, too_early = (
        link("a/2", "b/1", "overlapped", -2.0),
        link("a/2", "b/1", "overlapped", -9.0),
    )
    passage = link("a/1", "a/2", "visible", 6.0)
    assert related([inside]) == [("ab", "unseen_path", "unseen_path", "")]
    assert related([passage, inside]) == [("ab", "overlapped", "unseen_path", "overlapped")]
    assert related([passage, after]) == [("ab", "unseen_path", "unseen_path", "unseen_path")]
    assert related([passage, after], tolerance=1.0) == [
        ("ab", "overlapped", "unseen_path", "overlapped")
    ]
    assert related([passage, ahead]) == [("ab", "overlapped", "overlapped", "overlapped")]
    assert related([passage, too_early]) == [("ab", "overlapped", "overlapped", "unseen_path")]


# --- chain ---

LINKS = st.lists(
    st.builds(
        link,
        st.sampled_from([z.id for z in ZONES]),
        st.sampled_from([z.id for z in ZONES]),
        st.sampled_from(["visible", "unseen", "overlapped"]),
        st.just(5.0),
        st.sampled_from([0.1, 0.5, 1.0]),
    ),
    max_size=8,
)


@given(LINKS, st.lists(st.integers(0, 30), min_size=5, max_size=5))
def test_chain_equals_its_slow_twin(links: list[Link], exits: list[int]) -> None:
    zones = [zone(z.id, n) for z, n in zip(ZONES, exits, strict=True)]
    found = {
        (camera, to): share
        for camera, shares in estimate_markov_chain(zones, links).items()
        for to, share in shares.items()
    }
    assert list(found) == sorted(found)
    slow = naive.chain(zones, links)
    assert {pair: share for pair, share in found.items() if share} == pytest.approx(slow, abs=1e-6)
