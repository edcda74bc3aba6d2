"""The prior of the posterior: paths are two-way."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from synthetic_events import Views, fit_posterior

from camtopod.learn.association.candidates import find_candidates
from camtopod.learn.next_camera.fit import PosteriorFitter
from camtopod.learn.next_camera.prior import RETURNING, Prior
from camtopod.topology.lag_bins import LagBins

SHORT = LagBins(-3.0, 8.0)


def unrelated(seed: int, camera: list[int]) -> PosteriorFitter:
    """Return unrelated departures and arrivals in a minute; ``camera`` is that of each zone."""
    rng = np.random.default_rng(seed)
    views, of = Views(camera), np.array(camera)
    for t, zone in zip(
        rng.uniform(0, 60, 20), rng.integers(0, len(camera), 20).tolist(), strict=True
    ):
        out = rng.choice(np.flatnonzero(of == of[zone]))
        views.through(t, t + rng.exponential(4.0), zone, int(out))
    problem = views.problem(SHORT)._replace(until=60.0)
    return PosteriorFitter(problem, find_candidates(problem))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_it_equals_its_slow_twins(seed: int) -> None:
    fitter = unrelated(seed, [0, 0, 1, 3])
    prior = Prior(fitter.em.candidates, fitter.em.range_of, 4)
    named = list(
        zip(fitter.em.candidates.source.tolist(), fitter.em.candidates.target.tolist(), strict=True)
    )
    counts, rates = np.random.default_rng(seed).random((2, len(named), SHORT.size))
    returning = naive.returning(dict(zip(named, rates, strict=True)))
    number = dict(zip(named, counts.sum(axis=1).tolist(), strict=True))
    back = RETURNING * naive.two_way(number, RETURNING)
    expected = [returning[pair] for pair in named]
    found = np.where(prior.back[:, None] < 0, 0.0, rates[prior.back])
    assert found == pytest.approx(np.array(expected).reshape(-1, SHORT.size))
    assert prior.departures(counts.sum(axis=1)) == pytest.approx(back)


def test_what_comes_back_tells_what_goes_there() -> None:
    """Eight go from zone 0 to zone 1 among unrelated traffic; three hundred come back."""
    bins = LagBins(-20.0, 60.0)

    def believed(back: int) -> float:
        shares = []
        for seed in range(5):
            rng = np.random.default_rng(seed)
            views = Views([0, 1])
            for source, objects in ((0, 8), (1, back)):
                for t in rng.uniform(0, 40_000.0, objects):
                    views.through(t, t + 4.0, source, source)
                    views.through(
                        t + 4.0 + rng.normal(12, 1), t + rng.normal(20, 1), 1 - source, 1 - source
                    )
            for t, zone in zip(
                rng.uniform(0, 40_000.0, 1600), rng.integers(0, 2, 1600).tolist(), strict=True
            ):
                views.through(t, t + rng.uniform(3, 5), zone, zone)
            found = fit_posterior(views.problem(bins)._replace(until=40_060.0))
            c = found.fit.candidates
            there = (c.source[c.pair] == 0) & (c.target[c.pair] == 1)
            shares.append(float(found.fit.responsibility[there].sum()))
        return float(np.mean(shares))

    assert believed(back=300) > believed(back=0) + 2.0
