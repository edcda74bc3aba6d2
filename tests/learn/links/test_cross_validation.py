"""Evidence by cross-validation: exposure of the parts, and rare success under the null model."""

from __future__ import annotations

import numpy as np
import pytest

from camtopod.learn.association.candidates import find_candidates
from camtopod.learn.association.joint_fit import fit_jointly
from camtopod.learn.association.problem import Problem, exposures
from camtopod.learn.links.common_cycle import common_periods
from camtopod.learn.links.cross_validation import Halves, link_evidence
from camtopod.learn.traffic.events import Arrivals, Departures
from camtopod.topology.lag_bins import LagBins

BINS = LagBins(-60.0, 90.0)


def crowd(seed: int, zones: int, each: int, seconds: float) -> tuple[Departures, Arrivals]:
    """Return independent traffic; every zone is a camera, and dwell times are about
    five seconds.
    """
    rng = np.random.default_rng(seed)
    n = zones * each
    left, came = np.sort(rng.uniform(0, seconds, (2, n)))
    zone, other = rng.integers(0, zones, (2, n)).astype(np.int32)
    unknown = np.full(n, np.nan)
    departures = Departures.without_arrivals(
        left, zone, zone, left - rng.exponential(5.0, n), unknown
    )
    return departures, Arrivals(came, other, other, np.full(n, each / seconds), unknown)


@pytest.mark.parametrize("seconds", [300.0, 20_000.0])
def test_halves_together_see_what_the_whole_sees(seconds: float) -> None:
    """Except for arrivals before the first departure."""
    crowded = crowd(1, 4, 50, seconds)
    problem = Problem(*crowded, BINS, 4, seconds)
    fit = fit_jointly(problem, find_candidates(problem))
    halves = Halves(problem, problem, fit, 0.0)
    taken = [halves.take(k) for k in range(2)]
    assert sum(half.exposure for half in taken) == pytest.approx(exposures(problem))
    assert sum(len(half.candidates.lag) for half in taken) == len(fit.candidates.lag)
    assert sum(len(half.problem.arrivals.t) for half in taken) == len(problem.arrivals.t)


def test_chance_rarely_wins_where_it_is_dense_and_short() -> None:
    """Recordings hardly longer than the lags must not make short lags stand out.

    The bound allows one pair in exp(4) an evidence of four nats.
    """
    won, pairs = 0, 0
    for seed in range(4):
        crowded = crowd(seed, 8, 60, 600.0)
        problem = Problem(*crowded, BINS, 8, 600.0)
        fit = fit_jointly(problem, find_candidates(problem))
        ratio = link_evidence(problem, fit, 0.0, common_periods(problem, fit)).held_out
        won, pairs = won + int((ratio > 4.0).sum()), pairs + 64
        assert ratio.max(initial=0.0) < 7.0
    assert won <= pairs * np.exp(-4.0)
