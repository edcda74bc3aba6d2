"""Links that missed detections explain, and links that they do not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from camtopod.arrays import Floats
from camtopod.learn.links.link_table import (
    LinkTable,
    Transitions,
    concatenate_transitions,
    tabulate,
)
from camtopod.learn.links.missed_detections import (
    ODDS_QUANTILE,
    Views,
    missed_transitions,
    odds_of_others,
    skipped_paths,
)
from camtopod.learn.links.publishing import PublishingRule
from camtopod.learn.settings import Settings
from camtopod.topology.lag_bins import LagBins

SETTINGS = Settings(publish_probability_min=0.03, missed_share_max=0.25)
BINS = LagBins(-120.0, 180.0)
LEAVING = 400.0
WATCHED = np.zeros(9)
"""No camera was ever silent."""
Row = tuple[int, int, float, int]
"""Source, target, seconds, how many."""


def table(*rows: Row, zones: int = 9) -> LinkTable:
    """Return figures of transitions whose times vary by less than a second."""
    parts = []
    for source, target, lag, n in rows:
        spread = lag + np.linspace(-1.0, 1.0, n)
        column = (
            np.full(n, source, np.int32),
            np.full(n, target, np.int32),
            spread,
            np.full(n, 0.999),
        )
        parts.append(Transitions(*column, np.full(n, 1e-3)))
    return tabulate(concatenate_transitions(parts), np.full((zones, 1), LEAVING), BINS, zones)


CAMERA = np.array([0, 1, 1, 2, 2, 3, 3, 4, 4])
"""Zones 1 and 2 in camera 1, and so on; zone 0 alone in its own."""
THROUGH = table((1, 2, 5.0, 300), (3, 4, 5.0, 300), (5, 6, 5.0, 300), (7, 8, 5.0, 300))
CHAIN = ((0, 1, 10.0, 300), (2, 3, 10.0, 300), (4, 5, 10.0, 300), (6, 7, 10.0, 300))
"""0 -> (1 2) -> (3 4) -> (5 6) -> (7 8): every way seen 300 times; over one missed camera it takes
25 s.
"""


def kept(
    *rows: Row,
    through: LinkTable = THROUGH,
    silent: Floats = WATCHED,
    settings: Settings = SETTINGS,
) -> set[tuple[int, int]]:
    """Return the pairs that remain of these rows."""
    between = table(*rows)
    stays = PublishingRule(settings).judge(between, Views(through, silent)).published
    return {
        (int(u), int(v))
        for u, v, stay in zip(between.source, between.target, stays, strict=True)
        if stay
    }


LINKS = {(u, v) for u, v, _, _ in CHAIN}


def test_a_tenth_missed_everywhere() -> None:
    """300 recorded transitions imply 33 with a missed detection."""
    assert kept(*CHAIN, (0, 3, 25.0, 33), (2, 5, 25.0, 33), (4, 7, 25.0, 33)) == LINKS


def test_a_tenth_missed_where_the_fit_saw_no_others() -> None:
    """On a site of hundreds of zones hardly any such pair gets transitions."""
    assert kept(*CHAIN, (0, 3, 25.0, 33)) == LINKS


def test_several_missed_in_a_row() -> None:
    missed = ((0, 3, 25.0, 100), (2, 5, 25.0, 100), (4, 7, 25.0, 100))
    assert kept(*CHAIN, *missed, (0, 5, 40.0, 33), (2, 7, 40.0, 33), (0, 7, 55.0, 14)) == LINKS


def test_a_link_of_its_own_beside_a_way_stays() -> None:
    """It has many more transitions than elsewhere."""
    others = ((2, 5, 25.0, 33), (4, 7, 25.0, 33))
    assert kept(*CHAIN, *others, (0, 3, 25.0, 150)) == {*LINKS, (0, 3)}
    assert kept(*CHAIN, *others, (0, 3, 26.0, 33)) == LINKS


def test_a_camera_that_misses_little_explains_little() -> None:
    """90 are few if every camera misses a quarter, and many if hardly any misses one."""
    rows = (*CHAIN, (0, 3, 25.0, 90))
    assert (0, 3) not in kept(*rows, (2, 5, 25.0, 100), (4, 7, 25.0, 100))
    assert (0, 3) in kept(*rows, (2, 5, 25.0, 2), (4, 7, 25.0, 2))


def test_transitions_past_a_camera_that_misses_a_quarter() -> None:
    """300 recorded passages of two cameras imply 100 past the first one, 25 s later."""
    between = table(*CHAIN, (2, 5, 25.0, 100), (4, 7, 25.0, 100))
    found = np.isin(between.source * 9 + between.target, [u * 9 + v for u, v in LINKS])
    missed = missed_transitions(between, Views(THROUGH, WATCHED), found, SETTINGS.missed_share_max)
    assert [*zip(missed.source, missed.target, strict=True)] == [(0, 3), (2, 5), (4, 7)]
    assert missed.transitions == pytest.approx([100.0] * 3, rel=0.01)
    assert missed.place == pytest.approx([25.0] * 3, abs=0.5)
    one = between.transit.sd[found][0], THROUGH.transit.sd[0]
    assert missed.width == pytest.approx([np.sqrt(2 * one[0] ** 2 + one[1] ** 2)] * 3, rel=0.1)


def test_a_camera_that_was_silent_half_of_the_time_has_missed_as_many_as_it_has_seen() -> None:
    """Of the other cameras it tells nothing."""
    silent = np.where(CAMERA == 1, 1.0, 0.0)
    rows = (*CHAIN, (0, 3, 25.0, 300), (2, 5, 25.0, 33), (4, 7, 25.0, 33))
    assert kept(*rows) == {*LINKS, (0, 3)}
    assert kept(*rows, silent=silent) == LINKS
    assert (4, 7) in kept(*CHAIN, (0, 3, 25.0, 300), (4, 7, 25.0, 150), silent=silent)


def test_no_more_than_the_setting_says() -> None:
    rows = (*CHAIN, (0, 3, 25.0, 80), (2, 5, 25.0, 80), (4, 7, 25.0, 80))
    assert kept(*rows) == LINKS
    assert kept(*rows, settings=Settings(missed_share_max=0.05)) > LINKS
    assert len(kept(*rows, settings=Settings(missed_share_max=0.0))) == 7


@example(183, 39, 20)
@given(st.integers(0, 10**6), st.integers(0, 40), st.integers(0, 20))
def test_ways_equal_three_loops(seed: int, links: int, passages: int) -> None:
    rng = np.random.default_rng(seed)
    ends, times, numbers = (
        rng.integers(0, 9, (links, 2)),
        rng.uniform(1, 40, links),
        rng.integers(3, 20, links),
    )
    row = [
        (int(u), int(v), float(t), int(n))
        for (u, v), t, n in zip(ends, times, numbers, strict=True)
    ]
    pick = [(a, b) for a in range(1, 9) for b in range(1, 9) if CAMERA[a] == CAMERA[b]]
    seen = [(*pick[k], 5.0, 3 + int(k) % 9) for k in rng.integers(0, len(pick), passages)]
    between, through = table(*row), table(*seen)
    found = np.flatnonzero(rng.random(len(between.source)) < 0.7)
    silent = rng.uniform(0.0, 2.0, 9)
    expected, by_silent = np.zeros((2, 9, 9))
    for k in found:
        for j in range(len(through.source)):
            for m in found:
                if (
                    between.target[k] == through.source[j]
                    and through.target[j] == between.source[m]
                ):
                    total, stays = between.transit.total, through.transit.total
                    share = stays[j] / stays[through.source == through.source[j]].sum()
                    share /= stays[through.target == through.target[j]].sum()
                    pair = between.source[k], between.target[m]
                    expected[pair] += total[k] * share * total[m]
                    by_silent[pair] += total[k] * share * total[m] * silent[through.source[j]]
    paths, by_silence = skipped_paths(
        between, Views(through, silent), np.isin(np.arange(len(between.source)), found)
    )
    for transitions, total in ((paths.transitions, expected), (by_silence, by_silent)):
        ways = np.zeros((9, 9))
        ways[paths.source, paths.target] = transitions
        assert ways == pytest.approx(total)


@given(st.lists(st.tuples(st.integers(0, 20), st.integers(1, 40)), max_size=12))
def test_odds_are_a_quantile_of_the_others(pairs: list[tuple[int, int]]) -> None:
    seen, expected = np.array(pairs, float).reshape(-1, 2).T
    for k, odds in enumerate(odds_of_others(seen, expected)):
        others = sorted((s / e, e) for j, (s, e) in enumerate(pairs) if j != k)
        reached = np.cumsum([e for _, e in others])
        slow = np.inf
        if others:
            slow = others[int(np.argmax(reached >= ODDS_QUANTILE * reached[-1]))][0]
        assert odds == slow
