"""The posterior: entry kernels and exit kernels, overlaps where they show, pruning."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from synthetic_events import Views, fit_posterior

from camtopod.learn.association.candidates import Candidates, find_candidates
from camtopod.learn.association.joint_fit import fit_jointly
from camtopod.learn.links import FAINT_TRANSITIONS
from camtopod.learn.next_camera import fit as module
from camtopod.learn.next_camera.fit import Posterior, PosteriorFitter
from camtopod.learn.traffic.events import Arrivals, Departures
from camtopod.topology.lag_bins import LagBins

BINS = LagBins(-120.0, 120.0)


def share(found: Posterior, source: int, target: int) -> float:
    c = found.fit.candidates
    return float(found.share[(c.source == source) & (c.target == target)].sum())


def one_way(seed: int, objects: int, span: float, goes: float = 0.6, clutter: int = 0) -> Views:
    """Return traffic from zone 0 to zone 1, 8 s after the exit, and unrelated traffic at zone 2."""
    rng = np.random.default_rng(seed)
    views = Views([0, 1, 2])
    for t in rng.uniform(0, span, objects):
        views.through(t, t + rng.uniform(3, 5), 0, 0)
        if rng.random() < goes:
            came = views.rows[-1][1] + rng.normal(8, 1)
            views.through(came, came + rng.uniform(3, 5), 1, 1)
    for t in rng.uniform(0, span, clutter):
        views.through(t, t + rng.uniform(3, 5), 2, 2)
    return views


UNRELATED = [(0, 0), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1), (2, 2)]

# --- what it finds ---


def test_finds_the_share_the_time_and_who_leaves() -> None:
    found = fit_posterior(one_way(2, 1600, 32_000.0, clutter=800).problem(BINS))
    assert share(found, 0, 1) == pytest.approx(0.6, abs=0.04)
    assert max(share(found, *pair) for pair in UNRELATED) < 0.08
    c = found.fit.candidates
    (row,) = np.flatnonzero((c.source == 0) & (c.target == 1))
    assert BINS.centres[np.argmax(found.fit.hazard[row])] == pytest.approx(8.0, abs=1.0)
    assert found.leave == pytest.approx(np.array([0.4, 1.0, 1.0]), abs=0.1)


def test_what_comes_at_any_lag_is_doubted() -> None:
    found = fit_posterior(one_way(1, 400, 2000.0, clutter=300).problem(BINS))
    c = found.fit.candidates
    doubt = dict(
        zip(
            zip(c.source.tolist(), c.target.tolist(), strict=True),
            found.doubt.tolist(),
            strict=True,
        )
    )
    assert doubt[0, 1] < 0.25
    assert min(doubt[pair] for pair in UNRELATED if pair in doubt) > 2 * doubt[0, 1]
    assert all(0 <= share <= 1 for share in doubt.values())


def under_one_roof(seed: int, objects: int, span: float) -> tuple[Views, dict[float, float]]:
    """Return two overlapping views, and the true times of the next appearance by the time of the
    exit.

    5 s after entering the first view (zone 0) three in four are in the second (zone 1), which has
    visitors of its own; but they leave the first after 8 to 80 s.
    """
    rng = np.random.default_rng(seed)
    views, true = Views([0, 1]), {}
    for t in rng.uniform(0, span, objects):
        left = t + rng.uniform(8, 80)
        views.through(t, left, 0, 0)
        if rng.random() < 0.75:
            true[left] = t + rng.normal(5, 0.5)
            views.through(true[left], true[left] + rng.uniform(1, 3), 1, 1)
    for t in rng.uniform(0, span, objects // 4):
        views.through(t, t + rng.uniform(1, 3), 1, 1)
    return views, true


def right_share(
    candidates: Candidates,
    responsibility: np.ndarray,
    departures: Departures,
    arrivals: Arrivals,
    true: dict[float, float],
) -> float:
    """Return the share of the responsibility that is of true candidates."""
    pairs = zip(candidates.departure, candidates.arrival, strict=True)
    right = np.array([true.get(departures.t[d]) == arrivals.t[a] for d, a in pairs])
    return float(responsibility[right].sum()) / len(true)


def test_entry_kernels_know_when_the_exit_says_little() -> None:
    """Five objects are in the first view at a time; counted from the exit, lags
    spread over 72 s.
    """
    views, true = under_one_roof(3, 500, 5000.0)
    asked = views.problem(BINS)
    found, plain = fit_posterior(asked), fit_jointly(asked, find_candidates(asked))
    (row,) = np.flatnonzero((found.entry_source == 0) & (found.entry_target == 1))
    mass = found.entry_hazard[row] * BINS.widths
    assert BINS.centres[np.argmax(found.entry_hazard[row])] == pytest.approx(5.0, abs=0.5)
    assert mass[(BINS.edges[1:] > 3) & (BINS.edges[:-1] < 7)].sum() == pytest.approx(0.75, abs=0.1)
    assert share(found, 0, 1) == pytest.approx(0.75, abs=0.08)
    known = right_share(found.fit.candidates, found.fit.responsibility, *asked[:2], true)
    blind = right_share(plain.candidates, plain.responsibility, *asked[:2], true)
    assert known > 0.75
    assert blind < 0.25


def test_views_that_do_not_overlap_take_nothing_ahead_of_the_exit() -> None:
    """Coincidences ahead of the exit are dropped, but kept where views overlap."""
    apart = fit_posterior(one_way(4, 300, 4000.0, clutter=300).problem(BINS))
    assert (apart.fit.candidates.lag > 0).all()
    assert len(apart.entry_source) == 0
    together = fit_posterior(under_one_roof(4, 200, 4000.0)[0].problem(BINS))
    assert (together.fit.candidates.lag < 0).any()


def test_a_little_of_every_path_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Objects come after 8 s; that they may take a minute is not ruled out."""
    problem = one_way(4, 300, 4000.0).problem(BINS)
    late = BINS.edges[:-1] > 60.0
    known = fit_posterior(problem)
    monkeypatch.setattr(module, "FAINT_TRANSITIONS", 0.0)
    sure = fit_posterior(problem)
    faint, none = (
        float((one.fit.hazard * BINS.widths)[one.fit.candidates.target == 1][:, late].sum())
        for one in (known, sure)
    )
    after = BINS.edges[1:] > 0
    assert faint - none > 0.5 * FAINT_TRANSITIONS / 300 * late.sum() / after.sum()


# --- entry kernels, against their slow twins ---


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 25))
def test_entry_kernels_count_as_by_hand(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    views = Views([0, 0, 1, 2])
    for t in np.sort(rng.uniform(0, 60, n)):
        zone, way_out = rng.choice([(0, 0), (0, 1), (1, 0), (2, 2), (3, 3)])
        views.through(t, t + rng.exponential(6.0), zone, way_out)
    bins = LagBins(-20.0, 30.0)
    problem = views.problem(bins)
    departures, arrivals, *_ = problem
    unknown = rng.random(n) < 0.3
    departures = departures._replace(
        own=np.where(unknown, -1, departures.own).astype(np.int32),
        since=np.where(unknown, -np.inf, departures.since),
    )
    problem = problem._replace(departures=departures)
    found = find_candidates(problem)
    fitter = PosteriorFitter(problem, found)
    exposed, early = naive.entry_kernels(departures, arrivals, found, bins, 4)
    assert fitter.entry_kernels.exposure.tolist() == exposed.tolist()
    pairs = list(
        zip(fitter.entry_kernels.source.tolist(), fitter.entry_kernels.target.tolist(), strict=True)
    )
    assert pairs == sorted({pair for pair, _ in early.values()})
    assert fitter.entry_kernels.rows.tolist() == sorted(early)
    cells = [(pairs[k // bins.size], k % bins.size) for k in fitter.entry_kernels.cell.tolist()]
    assert cells == [early[c] for c in sorted(early)]
