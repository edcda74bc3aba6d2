"""Screening leaves out unlikely candidates and keeps those of a fit without it."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from camtopod.learn.association import screening as module
from camtopod.learn.association.candidates import (
    EXCESS_SMOOTHING_SD_BINS,
    Candidates,
    excess_over_null,
    find_candidates,
)
from camtopod.learn.association.em import START_FLOOR
from camtopod.learn.association.problem import Problem
from camtopod.learn.association.screening import (
    CandidateScreen,
    _likely,
    candidates_of_pairs,
    find_sources,
    place,
)
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.learn.traffic.background_rate import local_rates
from camtopod.learn.traffic.events import Arrivals, Departures
from camtopod.sim.scoring import Score, score
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.topology.lag_bins import SMOOTHING_SD_BINS, LagBins

BINS = LagBins(-20.0, 60.0)
SHORT = LagBins(-3.0, 8.0)
SCREENED, UNSCREENED = 100_000, 10**9
"""Candidates that two dozen cameras have more, and fewer, of."""


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
@given(st.integers(0, 10**6), st.integers(1, 80), st.integers(1, 80), st.integers(1, 300))
def test_what_is_kept_are_candidates(seed: int, left: int, came: int, most: int) -> None:
    ends = anything(seed, left, came)
    with pytest.MonkeyPatch.context() as limits:
        limits.setattr(module, "LIKELY_MAX", most)
        limits.setattr(module, "LIKELY_PER_ARRIVAL", 0)
        found = found_by(CandidateScreen(), ends, in_reach(*ends) - 1, 6)
    assert len(found.lag) <= most
    rows = listed(found)
    assert rows.items() <= listed(find_candidates(problem_of(ends, 6))).items()
    assert list(rows) == sorted(rows)
    pairs = list(zip(found.source.tolist(), found.target.tolist(), strict=True))
    assert pairs == sorted({(u, v) for _, u, v in rows.values()})


def true_ones(found: Candidates) -> list[bool]:
    """Return True for each candidate whose lag fits one of the two links of `site`."""
    near = {(3, 0): (8.0, 3.0), (17, 0): (30.0, 12.0)}
    return [
        (u, v) in near and abs(lag - near[u, v][0]) < near[u, v][1]
        for lag, u, v in listed(found).values()
    ]


def test_the_true_ones_among_many_are_kept() -> None:
    """Of 300,000 candidates nearly all are spurious."""
    ends = site(2)
    every, found = (
        find_candidates(problem_of(ends, 40)),
        found_by(CandidateScreen(), ends, in_reach(*ends) - 1, 40),
    )
    assert len(found.lag) < 0.5 * len(every.lag)
    assert sum(true_ones(found)) > 0.98 * sum(true_ones(every)) > 130


# --- candidates of one zone ---


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.integers(1, 25), st.integers(1, 25))
def test_likely_ones_equal_their_slow_twin(seed: int, left: int, came: int) -> None:
    departures, arrivals = anything(seed, left, came, zones=4, span=30.0)
    ends = module.screen_input(Problem(departures, arrivals, SHORT, 4, 40.0))
    zone = int(arrivals.zone[0])
    sources = np.flatnonzero(np.random.default_rng(seed).random(4) < 0.6)
    if not len(sources):
        return
    departure, arrival, lag, share = _likely(ends, zone, sources, ends.coming[zone])
    slow = naive.likely(
        departures,
        arrivals,
        zone,
        sources.tolist(),
        SHORT,
        ends.exposure,
        ends.chance.rates_of,
        lambda seen, usual: excess_over_null(seen, usual, SHORT, module.NOISE_SD),
        SMOOTHING_SD_BINS,
        (module.ROUNDS, module.OUTSIDE_FIRST, START_FLOOR, module.LIKELY_MIN),
    )
    rows = zip(zip(departure.tolist(), arrival.tolist(), strict=True), share.tolist(), strict=True)
    assert dict(rows) == pytest.approx(slow, rel=1e-6)
    exact = [arrivals.t[a] - departures.t[d] for d, a in zip(departure, arrival, strict=True)]
    assert lag.tolist() == np.array(exact, np.float32).tolist()


# --- looks over all pairs ---


@settings(max_examples=20)
@given(
    st.integers(0, 10**6),
    st.integers(1, 60),
    st.integers(1, 60),
    st.booleans(),
)
def test_what_stands_out_equals_its_slow_twin(
    seed: int, left: int, came: int, all_seen: bool
) -> None:
    departures, arrivals = anything(seed, left, came)
    problem = Problem(departures, arrivals, SHORT, 6, 60.0)
    ends = module.screen_input(problem)
    seen_min = 1 if all_seen else module.SEEN_MIN
    above = [
        naive.standing_out(
            departures,
            arrivals,
            zone,
            SHORT,
            ends.exposure,
            ends.chance.rates_of,
            seen_min,
            EXCESS_SMOOTHING_SD_BINS,
        )
        for zone in range(6)
    ]
    counted: list[float] = []
    weigh = module._above

    def above_chance(seen: np.ndarray, usual: np.ndarray, bins: LagBins) -> np.ndarray:
        counted.append(seen.sum())
        return weigh(seen, usual, bins)

    with pytest.MonkeyPatch.context() as limits:
        limits.setattr(module, "SEEN_MIN", seen_min)
        limits.setattr(module, "_above", above_chance)
        found = [find_sources(ends, zone).tolist() for zone in range(6)]
    assert found == [[u for u in range(6) if row[u] > module.STANDS_OUT_SD] for row in above]
    every = find_candidates(problem)
    pairs = np.bincount(every.pair, minlength=len(every.source))
    kept = np.where(pairs >= seen_min, pairs, 0)
    assert counted == np.bincount(every.target, kept, minlength=6).tolist()


def looked(screen: CandidateScreen, zones: int) -> list[int]:
    return [screen.followed[int(name)].looked for name in places_of(zones)]


def test_looks_go_round(monkeypatch: pytest.MonkeyPatch) -> None:
    """With room for one zone in each fit, the zone examined longest ago comes first."""
    monkeypatch.setattr(module, "LOOKS_MIN", 1)
    monkeypatch.setattr(module, "LOOKS_PER_EVENT", 0)
    ends, screen = anything(10, 200, 200), CandidateScreen()
    for fit in range(1, 13):
        found_by(screen, ends, 100, 6, fit)
        assert sorted(looked(screen, 6)) == [-1] * max(6 - fit, 0) + list(
            range(max(fit - 5, 1), fit + 1)
        )
    assert looked(screen, 6) == list(range(7, 13))


def test_where_there_is_no_other_fit_every_zone_is_looked_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "LOOKS_MIN", 1)
    monkeypatch.setattr(module, "LOOKS_PER_EVENT", 0)
    ends, screen = anything(10, 200, 200), CandidateScreen()
    screen.find(problem_of(ends, 6), places_of(6), 1, 100, everywhere=True)
    assert looked(screen, 6) == [1] * 6


def test_a_zone_that_is_no_more_is_forgotten_and_a_new_one_looked_at_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ends, screen = site(12), CandidateScreen()
    most = in_reach(*ends) // 2
    names = places_of(40)

    def find(learned: int) -> Candidates:
        return screen.find(problem_of(ends, 40), names, learned, most)

    assert {(3, 0), (17, 0)} <= {(u, v) for _, u, v in listed(find(1)).values()}
    old, names[3] = int(names[3]), place(99, 1)
    monkeypatch.setattr(module, "LOOKS_MIN", 1)
    monkeypatch.setattr(module, "LOOKS_PER_EVENT", 0)
    named = {(u, v) for _, u, v in listed(find(2)).values()}
    assert (3, 0) not in named, (
        "what left there went with the zone, and zone 0 has not been looked at again"
    )
    assert (17, 0) in named
    assert old not in screen.followed
    assert [screen.followed[int(name)].looked for name in names] == [1, 1, 1, 2, *[1] * 36]
    find(3)
    assert (3, 0) in {(u, v) for _, u, v in listed(find(4)).values()}


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
    monkeypatch.setattr(module, "LIKELY_MAX", 1)  # a few for each arrival
    network = SimSettings(cameras=24, hours=0.15, seed=2, linked=False, objects_per_second=4.0)
    assert learned(network, SCREENED)[1] == 0


def test_links_are_about_those_without_screening() -> None:
    network = SimSettings(cameras=24, hours=0.25, seed=1)
    (with_it, _), (without, _) = learned(network, SCREENED), learned(network, UNSCREENED)
    assert without.link_recall > 0.4
    assert with_it.link_recall > 0.95 * without.link_recall
    assert with_it.link_precision > without.link_precision - 0.03
