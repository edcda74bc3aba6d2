"""Screening leaves out unlikely candidates and keeps those of a fit without it."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from camtopod.learn.association import screening, weighing
from camtopod.learn.association.candidates import (
    Candidates,
    find_candidates,
)
from camtopod.learn.association.em import START_FLOOR
from camtopod.learn.association.joint_fit import Fit, fit_jointly
from camtopod.learn.association.problem import Problem
from camtopod.learn.association.screening import CandidateScreen, place, unexplained
from camtopod.learn.association.traffic_excess import WIDE_BINS, Traffic
from camtopod.learn.association.weighing import ZonePairs, candidates_of_pairs, likely
from camtopod.learn.lags import NOISE_SD, excess_over_null
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.learn.traffic.background_rate import local_rates
from camtopod.learn.traffic.events import Arrivals, Departures
from camtopod.sim.scoring import Score, score
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.topology.lag_bins import LagBins

BINS = LagBins(-20.0, 60.0)
SHORT = LagBins(-3.0, 8.0)
SCREENED, UNSCREENED = 20_000, 10**9
"""Candidates that a dozen cameras have more, and fewer, of."""


def anything(
    seed: int, left: int, came: int, zones: int = 6, span: float = 60.0
) -> tuple[Departures, Arrivals]:
    """Return unrelated departures and arrivals, with two zones to a camera."""
    rng = np.random.default_rng(seed)
    t, zone = np.sort(rng.uniform(0, span, left)), rng.integers(0, zones, left).astype(np.int32)
    stay = np.where(rng.random(left) < 0.3, np.inf, rng.exponential(4.0, left))
    departures = Departures.without_arrivals(t, zone, zone // 2, t - stay, np.full(left, np.nan))
    t, zone = np.sort(rng.uniform(0, span, came)), rng.integers(0, zones, came).astype(np.int32)
    return departures, Arrivals(
        t, zone, zone // 2, local_rates(t, zone, zones), np.full(came, np.nan)
    )


def site(seed: int, zones: int = 40, span: float = 4000.0) -> tuple[Departures, Arrivals]:
    """Return a site with two links among many zones.

    Of those who leave at 3 and 17 most are at 0 after 8 s and 30 s.
    """
    rng = np.random.default_rng(seed)
    departures, arrivals = anything(seed, 100 * zones, 100 * zones, zones, span)
    ways = ((3, 8.0, 1.0), (17, 30.0, 4.0))
    gone = [(departures.t[departures.zone == u], lag, sd) for u, lag, sd in ways]
    more = np.concatenate(
        [
            rng.permutation(t + rng.normal(lag, sd, len(t)))[: 7 * len(t) // 10]
            for t, lag, sd in gone
        ]
    )
    t = np.concatenate((arrivals.t, more))
    zone = np.concatenate((arrivals.zone, np.zeros(len(more), np.int32)))[
        np.argsort(t, kind="stable")
    ]
    t = np.sort(t)
    return departures, Arrivals(
        t, zone, zone // 2, local_rates(t, zone, zones), np.full(len(t), np.nan)
    )


def places_of(zones: int) -> np.ndarray:
    return np.array([place(zone // 2, zone % 2 + 1) for zone in range(zones)])


def found_by(
    screen: CandidateScreen,
    ends: tuple[Departures, Arrivals],
    most: int,
    zones: int,
    learned: int = 1,
) -> Candidates:
    return screen.find(problem_of(ends, zones), places_of(zones), learned, most)


def problem_of(ends: tuple[Departures, Arrivals], zones: int, bins: LagBins = BINS) -> Problem:
    until = max((float(one.t[-1]) for one in ends if len(one.t)), default=0.0)
    return Problem(*ends, bins, zones, until)


def listed(found: Candidates) -> dict[tuple[int, int], tuple[float, int, int]]:
    """Return (arrival, departure) -> lag and pair of zones."""
    rows = zip(
        found.arrival.tolist(),
        found.departure.tolist(),
        found.lag.tolist(),
        found.pair.tolist(),
        strict=True,
    )
    return {
        (a, d): (lag, int(found.source[pair]), int(found.target[pair])) for a, d, lag, pair in rows
    }


def in_reach(departures: Departures, arrivals: Arrivals) -> int:
    lag = arrivals.t[:, None] - departures.t
    return int(((lag >= BINS.lag_min) & (lag <= BINS.lag_max)).sum())


# --- what is found ---


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.integers(1, 80), st.integers(1, 80), st.integers(1, 4))
def test_what_is_kept_are_candidates(seed: int, left: int, came: int, most: int) -> None:
    ends = anything(seed, left, came)
    with pytest.MonkeyPatch.context() as limits:
        limits.setattr(weighing, "LIKELY_MAX", 0)
        limits.setattr(weighing, "LIKELY_PER_ARRIVAL", most)
        found = found_by(CandidateScreen(), ends, in_reach(*ends) - 1, 6)
    assert len(found.lag) <= most * came
    rows = listed(found)
    assert rows.items() <= listed(find_candidates(problem_of(ends, 6))).items()
    assert list(rows) == sorted(rows)
    pairs = list(zip(found.source.tolist(), found.target.tolist(), strict=True))
    assert pairs == sorted({(u, v) for _, u, v in rows.values()})


def true_ones(found: Candidates) -> list[bool]:
    """Return True for each candidate whose lag fits one of the two links of `site`."""
    near = {(3, 0): (8.0, 2.0), (17, 0): (30.0, 8.0)}
    return [
        (u, v) in near and abs(lag - near[u, v][0]) < near[u, v][1]
        for lag, u, v in listed(found).values()
    ]


def test_the_true_ones_among_many_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 300,000 candidates nearly all are spurious."""
    monkeypatch.setattr(weighing, "LIKELY_MAX", 0)
    ends = site(2)
    every, found = (
        find_candidates(problem_of(ends, 40)),
        found_by(CandidateScreen(), ends, in_reach(*ends) - 1, 40),
    )
    assert len(found.lag) < 0.5 * len(every.lag)
    assert sum(true_ones(found)) > 0.97 * sum(true_ones(every)) > 130


def test_a_zone_in_several_blocks_keeps_the_true_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each block has some of the arrivals at a zone, beside the null model of all of them."""
    monkeypatch.setattr(weighing, "LIKELY_MAX", 0)
    ends = site(2)
    every = true_ones(find_candidates(problem_of(ends, 40)))
    monkeypatch.setattr(weighing, "ZONE_WEIGHED_AT_ONCE", 8000)
    found = found_by(CandidateScreen(), ends, in_reach(*ends) - 1, 40)
    assert sum(true_ones(found)) > 0.9 * sum(every)


# --- weighing ---


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.integers(1, 25), st.integers(1, 25))
def test_likely_ones_equal_their_slow_twin(seed: int, left: int, came: int) -> None:
    departures, arrivals = anything(seed, left, came, zones=4, span=30.0)
    problem = Problem(departures, arrivals, SHORT, 4, 40.0)
    traffic = Traffic(problem)
    target, source = np.nonzero(np.random.default_rng(seed).random((4, 4)) < 0.4)
    blocks = [
        likely(traffic, ZonePairs(problem, source, target), block)
        for block in ZonePairs(problem, source, target).blocks(10**6)
    ]
    slow = naive.likely(
        departures,
        arrivals,
        list(zip(source.tolist(), target.tolist(), strict=True)),
        SHORT,
        traffic.exposure,
        traffic.null_model.rates_of,
        lambda seen, usual: excess_over_null(seen, usual, NOISE_SD),
        START_FLOOR,
        weighing.LIKELY_MIN,
    )
    found = [
        (int(d), int(block.arrivals[at]))
        for block in blocks
        for d, at in zip(block.departure, block.at, strict=True)
    ]
    assert sorted(found) == sorted(slow)
    for block in blocks:
        exact = arrivals.t[block.arrivals[block.at]] - departures.t[block.departure]
        assert block.lag.tolist() == exact.tolist()


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.integers(1, 40), st.integers(1, 40), st.integers(1, 60))
def test_blocks_have_every_candidate_once(seed: int, left: int, came: int, at_once: int) -> None:
    problem = problem_of(anything(seed, left, came), 6)
    target, source = np.nonzero(np.random.default_rng(seed).random((6, 6)) < 0.5)
    with pytest.MonkeyPatch.context() as limits:
        limits.setattr(weighing, "WEIGHED_AT_ONCE", 2 * at_once)
        limits.setattr(weighing, "ZONE_WEIGHED_AT_ONCE", at_once)
        blocks = list(ZonePairs(problem, source, target).blocks(10**6))
    found = [
        (int(block.arrivals[at]), int(d), int(source[pair]), int(target[pair]))
        for block in blocks
        for at, d, pair in zip(block.at, block.departure, block.pair, strict=True)
    ]
    asked = set(zip(source.tolist(), target.tolist(), strict=True))
    every = listed(find_candidates(problem)).items()
    assert sorted(found) == sorted((*rows, u, v) for rows, (_, u, v) in every if (u, v) in asked)


# --- looks over all pairs ---


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.integers(1, 60), st.integers(1, 60), st.booleans())
def test_what_stands_out_equals_its_slow_twin(seed: int, left: int, came: int, often: bool) -> None:
    departures, arrivals = anything(seed, left, came)
    problem = Problem(departures, arrivals, SHORT, 6, 80.0)
    traffic = Traffic(problem)
    if often:
        traffic._kind = np.uint32  # as on a site with too many candidates for short integers
    targets = np.random.default_rng(seed).permutation(6)[:4]
    rates = [
        [traffic.null_model.rates_of(*np.array([[u], [v]]))[0] for v in targets] for u in range(6)
    ]
    slow = [
        [
            naive.standing_out(departures, arrivals, u, v, SHORT, traffic.exposure, rate, WIDE_BINS)
            for v, rate in zip(targets.tolist(), rates[u], strict=True)
        ]
        for u in range(6)
    ]
    assert traffic.excess(targets) == pytest.approx(np.array(slow), rel=1e-4, abs=1e-4)


def test_many_events_of_a_zone_are_counted_exactly() -> None:
    """The pairs of 20,000 departures and as many arrivals are beyond single precision."""
    departures, arrivals = anything(1, 40_000, 40_000, zones=2, span=40_000.0)
    traffic = Traffic(Problem(departures, arrivals, SHORT, 2, 40_000.0))
    targets = np.arange(2)
    above = traffic.excess(targets)
    traffic._kind = np.int64
    assert above == pytest.approx(traffic.excess(targets), rel=1e-5)


def looked(screen: CandidateScreen, zones: int) -> list[int]:
    return [screen.sources_by_place[int(name)].looked for name in places_of(zones)]


def look_again(
    screen: CandidateScreen, problem: Problem, learned: int, everywhere: bool = False
) -> None:
    """Screen a problem, fit it, and look at what the fit leaves unexplained."""
    names = places_of(problem.zones)
    fit = fit_jointly(problem, screen.find(problem, names, learned, 100))
    assert screen.look_again(problem, fit, names, learned, everywhere)


def test_looks_go_round(monkeypatch: pytest.MonkeyPatch) -> None:
    """A new zone is looked at before the fit; after it, that with the oldest look comes first."""
    monkeypatch.setattr(screening, "LOOK_SHARE", 1 / 6)
    problem, screen = problem_of(anything(10, 200, 200), 6), CandidateScreen()
    for fit in range(1, 9):
        look_again(screen, problem, fit)
        assert sorted(looked(screen, 6)) == [1] * max(7 - fit, 0) + list(
            range(max(2, fit - 5), fit + 1)
        )


def test_before_the_last_fit_every_zone_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(screening, "LOOK_SHARE", 0.0)
    problem, screen = problem_of(anything(10, 200, 200), 6), CandidateScreen()
    for learned in (1, 2):
        look_again(screen, problem, learned)
    assert looked(screen, 6) == [1] * 6
    look_again(screen, problem, 3, everywhere=True)
    assert looked(screen, 6) == [3] * 6


def test_a_zone_that_is_no_more_is_forgotten_and_a_new_one_looked_at_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ends, screen = site(12), CandidateScreen()
    most = in_reach(*ends) // 2
    names = places_of(40)
    problem = problem_of(ends, 40)

    def find(learned: int) -> Candidates:
        return screen.find(problem, names, learned, most)

    assert {(3, 0), (17, 0)} <= {(u, v) for _, u, v in listed(find(1)).values()}
    old, names[3] = int(names[3]), place(99, 1)
    candidates = find(2)
    named = {(u, v) for _, u, v in listed(candidates).values()}
    assert (3, 0) not in named, (
        "what left there went with the zone, and zone 0 has not been looked at again"
    )
    assert (17, 0) in named
    assert old not in screen.sources_by_place
    assert [screen.sources_by_place[int(name)].looked for name in names] == [1, 1, 1, 2, *[1] * 36]
    monkeypatch.setattr(screening, "LOOK_SHARE", 0.1)
    assert screen.look_again(problem, fit_jointly(problem, candidates), names, 2)
    assert (3, 0) in {(u, v) for _, u, v in listed(find(3)).values()}


def chain(seed: int) -> tuple[Departures, Arrivals]:
    """Return a street of nine zones with much traffic, and a way of little traffic to its end.

    Objects pass zone after zone of 0 to 8, 5 s apart, so that departures from all of these precede
    arrivals at 8. Every few minutes one goes from zone 9 to zone 8.
    """
    rng = np.random.default_rng(seed)
    begin = np.sort(rng.uniform(0.0, 20_000.0, 2_000))
    times = begin[:, None] + np.cumsum(rng.normal(5.0, 0.5, (len(begin), 9)), axis=1)
    way = np.sort(rng.uniform(0.0, 20_000.0, 100))
    left = np.concatenate((times[:, :-1].ravel(), way))
    left_zone = np.concatenate((np.tile(np.arange(8), len(begin)), np.full(len(way), 9)))
    came = np.concatenate((times[:, 1:].ravel() - 1.0, way + rng.normal(20.0, 3.0, len(way))))
    came_zone = np.concatenate((np.tile(np.arange(1, 9), len(begin)), np.full(len(way), 8)))

    order = np.argsort(left)
    t, zone = left[order], left_zone[order].astype(np.int32)
    nothing = np.full(len(t), np.nan)
    departures = Departures.without_arrivals(t, zone, zone, t - 1.0, nothing)
    order = np.argsort(came)
    t, zone = came[order], came_zone[order].astype(np.int32)
    return departures, Arrivals(t, zone, zone, local_rates(t, zone, 10), np.full(len(t), np.nan))


def test_what_a_fit_explains_hides_no_other_link(monkeypatch: pytest.MonkeyPatch) -> None:
    """Six zones of a street stand out more than the source of a way of little traffic."""
    monkeypatch.setattr(screening, "SOURCES_MAX", 6)
    monkeypatch.setattr(screening, "UNCONFIRMED_SOURCES_MAX", 2)
    problem, screen = problem_of(chain(1), 10), CandidateScreen()
    names = np.array([place(zone, 1) for zone in range(10)])

    def fitted() -> Fit:
        return fit_jointly(problem, screen.find(problem, names, 1, 100))

    def sources() -> list[int]:
        return screen.sources_by_place[int(names[8])].sources.tolist()

    first = fitted()
    assert names[9] not in sources()
    assert screen.look_again(problem, first, names, 1, everywhere=True)
    assert {names[7], names[9]} <= set(sources())
    assert len(sources()) <= 4
    last = fitted()
    pairs = set(zip(last.candidates.source.tolist(), last.candidates.target.tolist(), strict=True))
    assert pairs >= {(9, 8)} | {(zone, zone + 1) for zone in range(8)}
    rest = unexplained(problem, last)
    assert len(rest.departures.t) < 0.05 * len(problem.departures.t)


# --- all candidates of what was found ---


@given(st.integers(0, 10**6), st.integers(1, 80), st.integers(1, 80), st.floats(0, 1))
def test_whole_pairs_have_all_their_candidates(
    seed: int, left: int, came: int, share: float
) -> None:
    ends = anything(seed, left, came)
    found = found_by(CandidateScreen(), ends, min(100, in_reach(*ends) - 1), 6)
    asked = np.flatnonzero(np.random.default_rng(seed).random(len(found.source)) < share)
    full = candidates_of_pairs(problem_of(ends, 6), found, asked)
    pairs = set(zip(found.source[asked].tolist(), found.target[asked].tolist(), strict=True))
    every = listed(find_candidates(problem_of(ends, 6)))
    assert listed(full) == {key: row for key, row in every.items() if row[1:] in pairs}
    assert list(listed(full)) == sorted(listed(full))
    assert (full.source == found.source).all()
    assert (full.target == found.target).all()
    assert set(full.pair.tolist()) <= set(asked.tolist())


# --- in a learner ---


def learned(network: SimSettings, candidates_max: int) -> tuple[Score, int]:
    """Return the accuracy of one batch fit, and the number of links between views."""
    events, truth = simulate(network)
    learner = Learner(Settings(refit_share=1e9, refit_hours=1e9, candidates_max=candidates_max))
    for event in events:
        learner.receive(event)
    learner.flush()
    assert learner.topology is not None
    assert bool(learner.save().followed) == (candidates_max == SCREENED)
    return score(learner.topology, truth), sum(
        link.relation != "visible" for link in learner.topology.links
    )


def test_where_there_are_no_links_none_is_published(monkeypatch: pytest.MonkeyPatch) -> None:
    """Screened pairs have the lags that were searched for, so some look like links by
    these alone.
    """
    network = SimSettings(cameras=12, hours=0.15, seed=2, linked=False, objects_per_second=2.0)
    assert learned(network, SCREENED)[1] == 0


def test_links_are_about_those_without_screening() -> None:
    network = SimSettings(cameras=12, hours=0.25, seed=1)
    (with_it, _), (without, _) = learned(network, SCREENED), learned(network, UNSCREENED)
    assert without.link_recall > 0.4
    assert with_it.link_recall > 0.95 * without.link_recall
    assert with_it.link_precision > without.link_precision - 0.03
