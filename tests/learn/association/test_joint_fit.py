"""The joint fit: candidates, E and M step against slow versions, and results on synthetic data."""

from __future__ import annotations

import naive
import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings, strategies as st

from camtopod.learn.association import candidates as candidates_module, em
from camtopod.learn.association.candidates import (
    Candidates,
    find_candidates,
    newest_within_limit,
)
from camtopod.learn.association.em import Em
from camtopod.learn.association.em_model import EmModel
from camtopod.learn.association.joint_fit import Fit, fit_jointly, flatness
from camtopod.learn.association.problem import Problem, exposures
from camtopod.learn.links.common_cycle import common_periods
from camtopod.learn.links.cross_validation import link_evidence
from camtopod.learn.traffic.background_rate import local_rates
from camtopod.learn.traffic.events import Arrivals, Departures
from camtopod.learn.traffic.speed import (
    NO_PERSISTENCE,
    USUAL_PASSAGES_MIN,
    Persistence,
    adjusted_lag,
    agreement,
    estimate_persistence,
    slowness,
)
from camtopod.topology.lag_bins import SMOOTHING_SD_BINS, LagBins, smooth
from camtopod.topology.shared_constants import DWELL_SECONDS_MIN, SLOWNESS_MAX

BINS = LagBins(-20.0, 120.0)
SINGLE = 1e-5
"""What is kept in single precision is right to so much after a few iterations."""
SHORT = LagBins(-3.0, 8.0)


def made(
    seed: int, left: int, came: int, zones: int = 3, span: float = 60.0
) -> tuple[Departures, Arrivals]:
    """Return unrelated departures and arrivals; every zone is a camera."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0, span, left))
    zone = rng.integers(0, zones, left).astype(np.int32)
    stay = np.where(rng.random(left) < 0.3, np.inf, rng.exponential(4.0, left))
    departures = Departures.without_arrivals(t, zone, zone, t - stay, np.full(left, np.nan))
    t = np.sort(rng.uniform(0, span, came))
    zone = rng.integers(0, zones, came).astype(np.int32)
    return departures, Arrivals(t, zone, zone, local_rates(t, zone, zones), np.full(came, np.nan))


def in_whole_seconds(departures: Departures, arrivals: Arrivals) -> tuple[Departures, Arrivals]:
    """Return the same, seen by cameras with one frame a second, so that many events coincide.

    A departure whose passage began with an arrival of its camera is tied to it.
    """
    t, came = np.floor(departures.t), np.floor(arrivals.t)
    since, own, free = np.floor(departures.since), departures.own.copy(), set(range(len(came)))
    for d in range(len(t)):
        began = [
            a
            for a in sorted(free)
            if came[a] <= t[d] and arrivals.camera[a] == departures.camera[d]
        ]
        if began:
            own[d], since[d] = began[-1], came[began[-1]]
            free.remove(began[-1])
    return departures._replace(t=t, since=since, own=own), arrivals._replace(t=came)


def listed(found: Candidates) -> list[tuple[int, int]]:
    return list(zip(found.departure.tolist(), found.arrival.tolist(), strict=True))


# --- candidates ---


@given(st.integers(0, 10**6), st.integers(0, 25), st.integers(0, 25), st.booleans())
def test_candidates_equal_a_double_loop(seed: int, left: int, came: int, in_step: bool) -> None:
    departures, arrivals = made(seed, left, came)
    if in_step:
        departures, arrivals = in_whole_seconds(departures, arrivals)
    problem = Problem(departures, arrivals, SHORT, 3, 60.0)
    with pytest.MonkeyPatch.context() as limits:
        limits.setattr(candidates_module, "CANDIDATES_AT_ONCE", 7)
        found = find_candidates(problem)
    slow = naive.candidates(departures, arrivals, -3.0, 8.0)
    assert listed(found) == slow
    assert found.lag == pytest.approx([arrivals.t[a] - departures.t[d] for d, a in slow])
    assert found.source[found.pair].tolist() == [departures.zone[d] for d, _ in slow]
    assert found.target[found.pair].tolist() == [arrivals.zone[a] for _, a in slow]
    pairs = list(zip(found.source.tolist(), found.target.tolist(), strict=True))
    assert pairs == sorted({(int(departures.zone[d]), int(arrivals.zone[a])) for d, a in slow})


@given(st.integers(0, 10**6), st.integers(1, 400))
def test_beyond_the_limit_only_the_newest_stretch_counts(seed: int, limit: int) -> None:
    departures, arrivals = made(seed, 40, 40)
    newest = newest_within_limit(Problem(departures, arrivals, SHORT, 3, 60.0), limit)
    left, came = newest.departures, newest.arrivals
    assert len(find_candidates(newest).lag) <= limit
    first = came.t[0] if len(came.t) else np.inf
    assert came.t.tolist() == [t for t in arrivals.t if t >= first]
    older = [t for t in arrivals.t if t < first]
    if not older:
        assert len(left.t) == len(departures.t)
        return
    assert left.t.tolist() == [t for t in departures.t if t >= first]
    assert (
        sum(-3.0 <= a - d <= 8.0 for a in arrivals.t if a >= older[-1] for d in departures.t)
        > limit
    )


def test_events_of_one_moment_are_within_the_limit_together_or_left_out() -> None:
    """Forty leave and seventeen come by one stamp; three come later."""
    departures, arrivals = made(1, 40, 20)
    moment = Problem(
        departures._replace(t=np.full(40, 30.0)),
        arrivals._replace(t=np.append(np.full(17, 30.0), [50.0, 51.0, 52.0])),
        SHORT,
        3,
        60.0,
    )
    assert newest_within_limit(moment, 17 * 40).arrivals.t[0] == 30.0
    assert newest_within_limit(moment, 17 * 40 - 1).arrivals.t.tolist() == [50.0, 51.0, 52.0]


# --- exposure, smoothing ---


@given(st.integers(0, 10**6), st.integers(0, 30), st.floats(-5, 90))
def test_exposures_equal_a_double_loop(seed: int, left: int, until: float) -> None:
    departures, arrivals = made(seed, left, 0)
    slow = naive.exposures(departures, SHORT, 3, until)
    found = exposures(Problem(departures, arrivals, SHORT, 3, until))
    assert found == pytest.approx(slow, abs=1e-9)


@given(st.integers(0, 10**6), st.floats(0, 100))
def test_smoothing_equals_its_slow_twin(seed: int, most: float) -> None:
    counts = np.random.default_rng(seed).random((4, SHORT.size)) * most / SHORT.size
    counts[0] = 0.0
    fast, stays = smooth(counts)
    assert fast.sum(axis=1) == pytest.approx(counts.sum(axis=1))
    for row in range(4):
        slow, share = naive.smoothed(counts[row], SMOOTHING_SD_BINS)
        assert fast[row] == pytest.approx(slow)
        assert stays[row] == pytest.approx(share)


# --- one iteration, and three ---


@settings(max_examples=30)
@given(
    st.integers(0, 10**6),
    st.sampled_from([1, 3]),
    st.sampled_from([0.0, 1.0]),
    st.sampled_from([1, 9, 1000]),
)
def test_iterations_equal_their_slow_twin(
    seed: int, iterations: int, sparsity: float, at_once: int
) -> None:
    departures, arrivals = made(seed, 20, 20)
    problem = Problem(departures, arrivals, SHORT, 3, 60.0)
    found = find_candidates(problem)
    fitter = Em(problem, found, EmModel(sparsity=sparsity))
    hazard = np.random.default_rng(seed).random((fitter.pairs, SHORT.size)) * 0.05
    named = list(zip(found.source.tolist(), found.target.tolist(), strict=True))
    with pytest.MonkeyPatch.context() as limits:
        limits.setattr(candidates_module, "CANDIDATES_AT_ONCE", at_once)
        hazards = hazard.astype(np.float32)
        for _ in range(iterations):
            fitter.expect(hazards)
            hazards = fitter.maximise()
    responsibility, counts, fresh, outside = naive.joint_fit(
        departures,
        arrivals,
        listed(found),
        dict(zip(named, hazard, strict=True)),
        SHORT,
        naive.exposures(departures, SHORT, 3, 60.0),
        3,
        0.5,
        sparsity,
        iterations,
        (em.LEAVE_FLOOR, em.OUTSIDE_FLOOR, SMOOTHING_SD_BINS),
    )
    assert fitter.responsibility == pytest.approx(np.array(responsibility), rel=SINGLE, abs=SINGLE)
    assert fitter.transitions() == pytest.approx(
        np.array([counts[z] for z in named]), rel=SINGLE, abs=SINGLE
    )
    assert hazards == pytest.approx(np.array([fresh[z] for z in named]), rel=SINGLE, abs=SINGLE)
    assert fitter.outside == pytest.approx(outside, rel=SINGLE)
    exposed = naive.exposures(departures, SHORT, 3, 60.0)[found.source] * SHORT.widths
    view = {
        int(zone): int(camera)
        for some in (departures, arrivals)
        for zone, camera in zip(some.zone, some.camera, strict=True)
    }
    for row, (source, target) in zip(exposed, named, strict=True):
        row[(SHORT.edges[1:] <= 0) & (view[source] == view[target])] = 0.0
    even = (hazards * exposed).sum(axis=1) / np.maximum(exposed.sum(axis=1), 1e-9)
    cells = SHORT.index(found.lag)
    assert flatness(fitter, hazards) == pytest.approx(
        [even[p] / max(hazards[p, k], em.NOTHING) for p, k in zip(found.pair, cells, strict=True)],
        rel=SINGLE,
    )


# --- what it finds ---


class Walks:
    """Objects that enter at a zone, cross its view and go on.

    Zone k is entry and exit of camera k.
    """

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.left: list[tuple[float, int, float]] = []
        self.came: list[tuple[float, int]] = []

    def go(self, objects: int, span: float, *way: tuple[int, float, float, float]) -> Walks:
        """Add objects that visit the zones in turn.

        ``steps``: (zone, lag to it, spread of the lag, share that goes there).
        """
        for t in self.rng.uniform(0, span, objects):
            for zone, lag, sd, share in way:
                if self.rng.random() > share:
                    break
                t += self.rng.normal(lag, sd)
                self.came.append((t, zone))
                entered, t = t, t + self.rng.uniform(3, 5)
                self.left.append((t, zone, entered))
        return self

    def columns(self, zones: int) -> tuple[Departures, Arrivals]:
        t, zone, since = (np.array(column) for column in zip(*sorted(self.left), strict=True))
        zone = zone.astype(np.int32)
        departures = Departures.without_arrivals(t, zone, zone, since, np.full(len(t), np.nan))
        t, zone = (np.array(column) for column in zip(*sorted(self.came), strict=True))
        zone = zone.astype(np.int32)
        return departures, Arrivals(
            t, zone, zone, local_rates(t, zone, zones), np.full(len(t), np.nan)
        )


def fitted(departures: Departures, arrivals: Arrivals, zones: int) -> Fit:
    problem = Problem(departures, arrivals, BINS, zones, float(departures.t[-1]))
    return fit_jointly(problem, find_candidates(problem))


def share(fit: Fit, departures: Departures, source: int, target: int) -> float:
    """Return the share of those leaving at ``source`` that appear next at ``target``."""
    at = (fit.candidates.source == source) & (fit.candidates.target == target)
    return float(fit.counts[at].sum() / (departures.zone == source).sum())


def test_finds_the_link_its_share_and_its_time() -> None:
    walks = Walks(1).go(400, 8000.0, (0, 0, 0, 1), (1, 8.0, 1.0, 0.6)).go(300, 8000.0, (2, 0, 0, 1))
    departures, arrivals = walks.columns(3)
    fit = fitted(departures, arrivals, 3)
    assert share(fit, departures, 0, 1) == pytest.approx(0.6, abs=0.07)
    others = [share(fit, departures, *pair) for pair in ((0, 2), (2, 1), (1, 2), (1, 0), (2, 0))]
    assert max(others) < 0.15
    (row,) = np.flatnonzero((fit.candidates.source == 0) & (fit.candidates.target == 1))
    assert BINS.centres[np.argmax(fit.hazard[row])] == pytest.approx(8.0, abs=1.0)
    assert fit.outside[1] < 0.15
    assert fit.outside[0] > 0.7


def test_an_indirect_way_is_no_link() -> None:
    """0 -> 1 -> 2 makes a clear peak from 0 to 2, but the transitions belong to zone 1."""
    departures, arrivals = (
        Walks(3).go(500, 20_000.0, (0, 0, 0, 1), (1, 8.0, 1.0, 1), (2, 6.0, 1.0, 1)).columns(3)
    )
    fit = fitted(departures, arrivals, 3)
    assert share(fit, departures, 0, 1) > 0.9
    assert share(fit, departures, 1, 2) > 0.9
    assert share(fit, departures, 0, 2) < 0.03


def test_overlapped_views_have_negative_lags() -> None:
    departures, arrivals = Walks(4).go(400, 8000.0, (0, 0, 0, 1), (1, -2.0, 0.3, 0.7)).columns(2)
    fit = fitted(departures, arrivals, 2)
    (row,) = np.flatnonzero((fit.candidates.source == 0) & (fit.candidates.target == 1))
    assert share(fit, departures, 0, 1) == pytest.approx(0.7, abs=0.07)
    assert fit.counts[row][BINS.edges[1:] <= 0].sum() > 0.95 * fit.counts[row].sum()


# --- evidence of the other half ---


def test_evidence_of_chance_is_small_and_of_a_link_large() -> None:
    walks = Walks(6).go(400, 12_000.0, (0, 0, 0, 1), (1, 8.0, 1.0, 0.5))
    for zone in (2, 3, 4, 5):
        walks.go(400, 12_000.0, (zone, 0, 0, 1))
    departures, arrivals = walks.columns(6)
    fit = fitted(departures, arrivals, 6)
    problem = Problem(departures, arrivals, BINS, 6, 12_000.0)
    ratio = link_evidence(problem, fit, 0.0, common_periods(problem, fit)).held_out
    linked = (fit.candidates.source == 0) & (fit.candidates.target == 1)
    assert ratio[linked] > 100
    assert (ratio[~linked] < np.log(36 * 100)).all()


# --- slowness ---


@given(st.integers(0, 10**6), st.integers(0, 40))
def test_slowness_equals_its_slow_twin(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    source, target = rng.integers(0, 3, (2, n)).astype(np.int32)
    stay = rng.exponential(3.0, n)
    slow = naive.slowness(source, target, stay, USUAL_PASSAGES_MIN, DWELL_SECONDS_MIN, SLOWNESS_MAX)
    assert slowness(source, target, stay, 3) == pytest.approx(slow, nan_ok=True)


def walkers(seed: int, n: int, own: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return slowness before and after, and lag, of n walkers.

    Slowness lasts; ``own`` is its spread.
    """
    rng = np.random.default_rng(seed)
    pace = own * rng.standard_normal(n)
    left, came, way = (pace + 0.1 * rng.standard_normal(n) for _ in range(3))
    return left, came, 20.0 * np.exp(way)


def test_persistence_of_those_who_keep_their_speed() -> None:
    left, came, lag = walkers(0, 800, 0.3)
    found = estimate_persistence(left, came, lag, np.zeros(800, np.int32), np.ones(800))
    assert found.correlation == pytest.approx(
        0.9, abs=0.09
    )  # 0.09 / (0.09 + 0.01), less its uncertainty
    assert found.sd == pytest.approx(np.sqrt(0.1), rel=0.1)
    assert found.scaling == pytest.approx(0.95, abs=0.1)


def test_no_persistence_where_there_is_none() -> None:
    left, came, lag = walkers(1, 800, 0.0)
    found = estimate_persistence(left, came, lag, np.zeros(800, np.int32), np.ones(800))
    assert found.correlation == pytest.approx(0, abs=0.05)
    assert found.scaling == pytest.approx(0, abs=0.15)


def test_adjusted_lag() -> None:
    """An object e^0.5 times slower takes 20 s where others take 12; short and unknown lags stay."""
    lag = np.array([20.0, 20.0, 1.0, -5.0, 119.0])
    slow = np.array([0.5, np.nan, 0.5, 0.5, -0.5])
    assert adjusted_lag(lag, slow, 1.0) == pytest.approx(
        [20 * np.exp(-0.5), 20.0, 1.0, -5.0, 119 * np.exp(0.5)]
    )
    assert adjusted_lag(lag, slow, 0.0).tolist() == lag.tolist()


def test_agreement_is_the_ratio_of_densities() -> None:
    rng = np.random.default_rng(0)
    left, came = rng.standard_normal((2, 50)) * 0.4
    p = Persistence(0.0, 0.7, 0.4)
    together = scipy.stats.multivariate_normal([0, 0], 0.16 * np.array([[1, 0.7], [0.7, 1]]))
    apart = scipy.stats.norm(0, 0.4)
    ratio = together.pdf(np.column_stack([left, came])) / (apart.pdf(left) * apart.pdf(came))
    assert agreement(left, came, p) == pytest.approx(ratio)
    assert agreement(np.array([np.nan, 1.0]), np.array([0.0, np.nan]), p).tolist() == [1.0, 1.0]
    assert agreement(left, came, NO_PERSISTENCE).tolist() == [1.0] * 50


def test_speed_tells_who_is_who() -> None:
    """With two objects on the path at once, known speeds make the fit surer of the right ones."""
    rng = np.random.default_rng(7)
    rows, ends = [], []
    for k, t in enumerate(np.sort(rng.uniform(0, 16_000, 400))):
        pace = 0.4 * rng.standard_normal()
        arrives = t + 30.0 * np.exp(pace + 0.05 * rng.standard_normal())
        rows.append((t, pace + 0.05 * rng.standard_normal()))
        ends.append((arrives, pace + 0.05 * rng.standard_normal(), k))
    left_t, left_slow = (np.array(column) for column in zip(*rows, strict=True))
    came_t, came_slow, who = (np.array(column) for column in zip(*sorted(ends), strict=True))
    zone, other = np.zeros(400, np.int32), np.ones(400, np.int32)
    right = []
    for known in (1.0, np.nan):
        departures = Departures.without_arrivals(
            left_t, zone, zone, left_t - 5.0, left_slow * known
        )
        arrivals = Arrivals(came_t, other, other, local_rates(came_t, other, 2), came_slow * known)
        fit = fitted(departures, arrivals, 2)
        true = who[fit.candidates.arrival] == fit.candidates.departure
        right.append(fit.responsibility[true].sum() / 400)
    assert right[0] > right[1] + 0.1
    assert right[0] > 0.7
