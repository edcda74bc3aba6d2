"""Skipped cameras: an object missed by a camera is seen next where that camera leads."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from prediction_quality import prediction_quality
from synthetic_events import Views, fit_posterior

from bench.support.regimes import REGIMES
from camtopod.learn import refit
from camtopod.learn.association.candidates import Candidates, find_candidates, number_pairs
from camtopod.learn.next_camera import fit, skip_rate, skipped_cameras as module
from camtopod.learn.next_camera.fit import Posterior
from camtopod.learn.next_camera.skipped_cameras import (
    Legs,
    ViewPaths,
    legs_of,
    skip_hazards,
    view_paths,
)
from camtopod.learn.traffic.events import Departures
from camtopod.topology.lag_bins import LagBins
from camtopod.topology.shared_constants import LEAVE_FLOOR, UNKNOWN_DWELL_SECONDS

BINS = LagBins(-60.0, 120.0)
CAMERA = np.array([0, 1, 1, 2, 2, 3], np.int64)
SITE = Views([0, 1, 1, 2, 2, 3])


def walks(seed: int, objects: int, missed: float, span: float = 30_000.0) -> Views:
    """Return walks 0 -> (1 2) -> (3 4) -> 5, or off after the first view.

    The views in between miss some.
    """
    rng = np.random.default_rng(seed)
    views = Views(SITE.camera.tolist())
    for t in rng.uniform(0, span, objects):
        legs = [(0, 0), (1, 2), (3, 4), (5, 5)]
        for k, (entry, leave) in enumerate(legs[: 4 if rng.random() < 0.7 else 1]):
            stay = rng.uniform(4, 6)
            if k in (0, 3) or rng.random() >= missed:
                views.through(t, t + stay, entry, leave)
            t += stay + rng.normal(10, 1)
    return views


def learned(views: Views) -> Posterior:
    return fit_posterior(views.problem(BINS))


def screened(views: Views, pairs: set[tuple[int, int]]) -> tuple[Posterior, Posterior]:
    """Learn the candidates of these pairs of zones only, without and with the paths beside them."""
    problem = views.problem(BINS)
    departures, arrivals, _, zones, _ = problem
    every = find_candidates(problem)
    named = list(
        zip(
            departures.zone[every.departure].tolist(),
            arrivals.zone[every.arrival].tolist(),
            strict=True,
        )
    )
    kept = np.array([pair in pairs for pair in named])
    pair, source, target = number_pairs(
        departures.zone[every.departure[kept]], arrivals.zone[every.arrival[kept]], zones
    )
    few = Candidates(
        every.departure[kept], every.arrival[kept], pair, every.lag[kept], source, target
    )
    return fit_posterior(problem, few), fit_posterior(problem, few, screened=True)


def share(found: Posterior, source: int, target: int) -> float:
    c = found.fit.candidates
    return float(found.share[(c.source == source) & (c.target == target)].sum())


# --- what it is for ---


@pytest.mark.parametrize("missed", [0.0, 0.1, 0.35])
def test_as_many_as_are_missed(missed: float) -> None:
    found = learned(walks(5, 1500, missed, 60_000.0))
    assert share(found, 0, 3) == pytest.approx(0.7 * missed * (1 - missed), abs=0.03)
    assert share(found, 0, 5) == pytest.approx(0.7 * missed**2, abs=0.03)


def test_ways_too_rare_to_be_found_are_foretold(monkeypatch: pytest.MonkeyPatch) -> None:
    """The site has 12 cameras that miss a tenth, recorded for an hour; without second opinion."""
    monkeypatch.setattr(refit, "is_wanted", lambda scene, cameras: False)
    networks = [REGIMES["short"].make(seed, 0.3) for seed in (20, 21)]
    with_ways = [prediction_quality(*network) for network in networks]
    nothing = lambda *asked: (np.zeros(0, np.int64), np.zeros((0, asked[3].size)))  # noqa: E731
    monkeypatch.setattr(fit, "skip_hazards", nothing)
    without = [prediction_quality(*network) for network in networks]
    loss, top3 = (
        np.mean(
            [one[figure] - other[figure] for one, other in zip(with_ways, without, strict=True)]
        )
        for figure in ("log_loss", "top3")
    )
    assert loss < -0.02
    assert top3 > -0.005


def test_ways_that_screening_left_out_are_foretold_beside_the_others() -> None:
    """The odds cannot be learned from these pairs, so they are the initial ones, a tenth."""
    without, found = screened(walks(6, 600, 0.1), {(0, 1), (2, 3), (4, 5), (5, 0)})
    for u, a, b, v in ((0, 1, 2, 3), (2, 3, 4, 5)):
        taken = share(found, u, a) * share(found, b, v)
        assert share(without, u, v) == 0
        assert share(found, u, v) == pytest.approx(skip_rate.ODDS_FIRST * taken, rel=0.05)
    rows = [dict(zip(pairs_of(one), range(99), strict=False)) for one in (without, found)]
    assert list(rows[1]) == sorted(rows[1])
    old, new = list(rows[0].values()), [rows[1][pair] for pair in rows[0]]
    for before, after in zip(columns_of(without), columns_of(found), strict=True):
        assert (before[old] == after[new]).all()
    beside = [row for pair, row in rows[1].items() if pair not in rows[0]]
    assert {(0, 3), (2, 5)} <= {pairs_of(found)[row] for row in beside}
    assert not found.doubt[beside].any()
    assert found.share[beside] == pytest.approx(
        (found.fit.hazard[beside] * BINS.widths).sum(axis=1)
    )
    (at,) = [row for row in beside if pairs_of(found)[row] == (0, 3)]
    assert BINS.centres[np.argmax(found.fit.hazard[at])] == pytest.approx(25.0, abs=3.0)
    both = without.fit.candidates, found.fit.candidates
    assert all((c.source[c.pair] == both[0].source[both[0].pair]).all() for c in both)
    assert all((c.target[c.pair] == both[0].target[both[0].pair]).all() for c in both)
    gone = np.bincount(
        found.fit.candidates.source[beside], found.share[beside], minlength=len(CAMERA)
    )
    assert found.leave == pytest.approx(np.maximum(without.leave - gone, LEAVE_FLOOR))


def pairs_of(found: Posterior) -> list[tuple[int, int]]:
    return list(
        zip(found.fit.candidates.source.tolist(), found.fit.candidates.target.tolist(), strict=True)
    )


def columns_of(found: Posterior) -> list[np.ndarray]:
    """Return all columns with a row for each pair."""
    return [found.share, found.doubt, found.fit.hazard]


# --- its slow twins ---


@given(st.integers(0, 10**6), st.integers(0, 60), st.floats(0.0, 1.0))
@settings(max_examples=60)
def test_ways_through_equal_loops(seed: int, n: int, tied: float) -> None:
    rng = np.random.default_rng(seed)
    zone = rng.integers(0, len(CAMERA), n).astype(np.int32)
    t = np.sort(rng.uniform(0, 1000, n))
    alone = np.array(
        [
            np.flatnonzero(CAMERA[z] == CAMERA)[rng.integers(0, (CAMERA[z] == CAMERA).sum())]
            for z in zone
        ]
    )
    entry = np.where(rng.random(n) < tied, alone, -1).astype(np.int64)
    since = np.where(
        (entry >= 0) | (rng.random(n) < 0.3), t - rng.uniform(1, 30, n).round(2), -np.inf
    )
    departures = Departures.without_arrivals(
        t, zone, CAMERA[zone].astype(np.int32), since, np.full(n, np.nan)
    )
    fast = view_paths(departures, entry, CAMERA)
    slow = naive.ways_through(
        departures,
        entry,
        CAMERA,
        module.PASSAGE_SHARE_MIN,
        module.TIED_SHARE_MIN,
        UNKNOWN_DWELL_SECONDS,
    )
    found = {
        (a, b): (p, s) for a, b, p, s in zip(*(column.tolist() for column in fast), strict=True)
    }
    assert len(found) == len(fast.entry)
    assert found.keys() == slow.keys()
    for way, figures in slow.items():
        assert found[way] == pytest.approx(figures)


Ways = dict[tuple[int, int], tuple[float, float]]


def some_links(
    seed: int, pairs: int, passages: int
) -> tuple[np.ndarray, Candidates, ViewPaths, Ways]:
    """Return appearance probabilities by lag, pairs, and paths through views, in two forms."""
    rng = np.random.default_rng(seed)
    zones = len(CAMERA)
    key = np.sort(rng.choice(zones * zones, pairs, replace=False))
    source, target = (key // zones).astype(np.int32), (key % zones).astype(np.int32)
    appears = rng.dirichlet(np.full(BINS.size, 0.05), pairs) * rng.uniform(0.0, 0.6, (pairs, 1))
    ways = sorted({(int(rng.integers(zones)), int(rng.integers(zones))) for _ in range(passages)})
    through = {way: (float(rng.uniform(0.02, 1.0)), float(rng.uniform(1, 40))) for way in ways}
    none = np.zeros(0, np.int32)
    came, left = (np.array([way[k] for way in ways], np.int64) for k in (0, 1))
    passes, seconds = (np.array([through[way][k] for way in ways]) for k in (0, 1))
    candidates = Candidates(none, none, none, np.zeros(0), source, target)
    return appears, candidates, ViewPaths(came, left, passes, seconds), through


def legs(appears: np.ndarray, candidates: Candidates) -> Legs:
    return legs_of(appears.sum(axis=1), lambda some: appears[some], candidates, BINS)


def by_hand(appears: np.ndarray, source: list[int], target: list[int], ways: Ways) -> np.ndarray:
    return naive.skip_hazards(
        appears,
        source,
        target,
        ways,
        BINS,
        module.LEG_QUANTILES,
        module.SPREAD_SD_BINS,
        module.LINK_SHARE_MIN,
        module.WAY_SHARE_MIN,
    )


@given(st.integers(0, 10**6), st.integers(1, 20), st.integers(0, 8))
@settings(max_examples=40)
def test_skip_hazards_equal_loops(seed: int, pairs: int, passages: int) -> None:
    appears, candidates, through, ways = some_links(seed, pairs, passages)
    pair, hazard = skip_hazards(legs(appears, candidates), candidates, through, BINS, len(CAMERA))
    fast = np.zeros_like(appears)
    fast[pair] = hazard
    slow = by_hand(appears, candidates.source.tolist(), candidates.target.tolist(), ways)
    assert fast == pytest.approx(slow, abs=1e-12)
