"""Evidence where zones follow one cycle: what the phase makes is no way, and a way is one."""

from __future__ import annotations

import numpy as np
import pytest

from camtopod.learn.association.candidates import find_candidates
from camtopod.learn.association.joint_fit import Fit, fit_jointly
from camtopod.learn.association.problem import Problem
from camtopod.learn.links.common_cycle import (
    COPIES,
    common_periods,
    evidence_against_cycle,
    moved,
    way_lags,
    without_cycle,
)
from camtopod.learn.links.cross_validation import link_evidence
from camtopod.learn.links.significance import log_likelihood_ratio
from camtopod.learn.traffic.events import Arrivals, Departures
from camtopod.topology.lag_bins import LagBins
from tests import naive

BINS = LagBins(-60.0, 90.0)
SECONDS = 3 * 3600.0
PERIOD = 50.0
WAY = (0, 1)
"""Two zones that a way of about 20 s joins."""
PHASE = (0, 2)
"""Two zones that only have the cycle in common: platoons leave the one and reach the other."""


def street(seed: int, period: float = PERIOD) -> Problem:
    """Return the traffic of three views whose lights share a cycle; departures are at zone 0.

    period (seconds): that of the lights; with 0 there are none.
    """
    rng = np.random.default_rng(seed)

    def platoons(n: int, phase: float) -> np.ndarray:
        """Return n times at which the light is green, a third of the cycle."""
        if not period:
            return np.sort(rng.uniform(0, SECONDS, n))
        cycle = rng.integers(0, int(SECONDS / period), n)
        return np.sort((cycle + phase + rng.uniform(0, 0.35, n)) * period)

    left = platoons(700, 0.0)
    went = left[rng.random(len(left)) < 0.7]
    came = [np.append(went + rng.normal(20.0, 3.0, len(went)), platoons(150, 0.4))]
    came.append(platoons(600, 0.6))
    t = np.concatenate(came)
    zone = np.repeat(np.array([1, 2], np.int32), [len(some) for some in came])
    order = np.argsort(t, kind="stable")
    t, zone = t[order], zone[order]
    source = np.zeros(len(left), np.int32)
    departures = Departures.without_arrivals(left, source, source, left, np.full(len(left), np.nan))
    rate = np.bincount(zone)[zone] / SECONDS
    arrivals = Arrivals(t, zone, zone, rate, np.full(len(t), np.nan))
    return Problem(departures, arrivals, BINS, 3, SECONDS + 90.0)


def by_pair(fit: Fit, values: np.ndarray) -> dict[tuple[int, int], float]:
    """Return the values (P,) of a fit by its pairs of zones; 0 for others."""
    pairs = zip(fit.candidates.source.tolist(), fit.candidates.target.tolist(), strict=True)
    return {WAY: 0.0, PHASE: 0.0} | dict(zip(pairs, values.tolist(), strict=True))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_phase_is_no_way_and_a_way_is_one(seed: int) -> None:
    """Without the rule, the difference of two phases has the evidence of a link."""
    problem = street(seed)
    before = fit_jointly(problem, find_candidates(problem))
    c = before.candidates
    unaware = log_likelihood_ratio(c.pair, before.responsibility, before.flat, len(c.source))
    assert by_pair(before, unaware)[PHASE] > 8.0

    fit, period_of = without_cycle(problem, before)

    period = by_pair(fit, period_of)
    evidence = link_evidence(problem, fit, 0.0, period_of)
    whole, held_out = by_pair(fit, evidence.whole), by_pair(fit, evidence.held_out)
    assert period[WAY] == pytest.approx(PERIOD, rel=0.01)
    assert (whole[WAY] + held_out[WAY]) / 2 > 15.0
    assert (whole[PHASE] + held_out[PHASE]) / 2 < 4.0


def test_without_a_cycle_nothing_changes() -> None:
    problem = street(1, 0.0)
    fit = fit_jointly(problem, find_candidates(problem))
    assert np.isnan(common_periods(problem, fit)).all()
    assert without_cycle(problem, fit)[0] is fit


@pytest.mark.parametrize("seconds", [1.0, 100.0, 340.0])
def test_a_window_of_a_few_periods_has_none(seconds: float) -> None:
    problem = street(1)
    c = find_candidates(problem)
    fit = fit_jointly(problem, c)
    first = float(problem.departures.t[0])
    now = problem.departures.t < first + seconds
    early = problem.arrivals.t < first + seconds
    short = problem._replace(
        departures=problem.departures.take(now, early),
        arrivals=problem.arrivals.take(problem.arrivals.t < first + max(seconds, 60.0)),
        until=first + seconds,
    )
    assert np.isnan(common_periods(short, fit)).all()


def test_a_fit_keeps_a_way_at_its_lag() -> None:
    """What the cycle makes at other lags is left out."""
    problem = street(4)
    fit, _ = without_cycle(problem, fit_jointly(problem, find_candidates(problem)))
    way = by_pair(fit, np.arange(len(fit.counts)))[WAY]
    lag = fit.counts[int(way)] @ BINS.centres / fit.counts[int(way)].sum()
    assert lag == pytest.approx(20.0, abs=2.0)


@pytest.mark.parametrize("copy", [0, *COPIES])
def test_moved_departures_make_the_rates_of_their_definition(copy: int) -> None:
    """They come back at the other end of the window; after its last whole period nothing counts."""
    until = 1_525.0
    problem = street(5)._replace(until=until)
    hazard = np.append(np.random.default_rng(5).uniform(0, 0.01, BINS.size - 1), 0.0)
    some = moved(problem, *WAY, copy * PERIOD, PERIOD)
    comes = problem.arrivals.t[problem.arrivals.zone == WAY[1]]
    rate = np.bincount(some.arrival, hazard[BINS.index(some.lag.astype(float))], len(comes))

    part = np.r_[:30, len(comes[comes < until]) - 30 : len(comes[comes < until]) + 5]
    left = problem.departures.t[problem.departures.t < until]
    slow = naive.cycle_rates(
        left, comes[part], hazard, BINS.edges, left[0], until, copy * PERIOD, PERIOD
    )
    assert slow.min() == 0.0 < slow.max()
    assert rate[part] == pytest.approx(slow)


def test_the_evidence_against_a_cycle_is_a_product_over_arrivals() -> None:
    """It compares the true departures with the mean of all copies, beside the rate of all else."""
    problem = street(6)
    fit = fit_jointly(problem, find_candidates(problem))
    period = np.full(len(fit.counts), PERIOD)
    nothing = np.zeros(len(fit.responsibility))
    outside = np.full(3, 0.5)
    c = fit.candidates
    nats = evidence_against_cycle(problem, c, fit.hazard, nothing, outside, period)

    comes = np.flatnonzero(problem.arrivals.zone == WAY[1])
    way = int(by_pair(fit, np.arange(len(fit.counts)))[WAY])
    rates = []
    for k in (0, *COPIES):
        some = moved(problem, *WAY, k * PERIOD, PERIOD)
        at = BINS.index(some.lag.astype(float))
        rates.append(np.bincount(some.arrival, fit.hazard[way][at], len(comes)))
    beside = 0.5 * problem.arrivals.rate[comes]
    product = np.prod((beside + rates[0]) / (beside + sum(rates) / len(rates)))
    assert nats[way].sum() == pytest.approx(np.log(product))


def test_saturated_platoons_tell_by_a_small_excess() -> None:
    """Copies that hardly differ leave little noise; copies that do leave much."""
    course = 40.0 + 30.0 * np.sin(np.arange(BINS.size) / 3)
    counts = course + np.where(np.abs(BINS.centres - 20.0) < 4.0, 10.0, 0.0)
    rng = np.random.default_rng(7)
    alike = course + rng.normal(0, 0.5, (6, BINS.size))
    unlike = course + rng.normal(0, 1, (6, 1)) * np.sqrt(course) * 2.0
    assert set(np.flatnonzero(way_lags(counts, alike))) >= {BINS.bin_of(20.0)}
    assert not way_lags(counts, unlike).any()


def test_a_window_that_ends_before_it_begins_has_no_period() -> None:
    """The clock of a camera is known to be faster than the few seconds of the window are long."""
    problem = street(1)
    fit = fit_jointly(problem, find_candidates(problem))
    first = float(problem.departures.t[0])
    assert np.isnan(common_periods(problem._replace(until=first - 60.0), fit)).all()
