"""Contexts of a departure: counts, back-off, and information about the next camera."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from synthetic_events import Views

from camtopod.learn.association.candidates import Candidates, find_candidates
from camtopod.learn.association.problem import Problem
from camtopod.learn.next_camera import contexts as module
from camtopod.learn.next_camera.contexts import LEVELS, ContextLevel, Contexts
from camtopod.learn.traffic.events import Arrivals, Departures
from camtopod.topology.lag_bins import LagBins

SHORT = LagBins(-3.0, 8.0)
CAMERAS = np.array([0, 0, 1, 2], np.int32)
"""Camera of each of four zones."""
SINGLE = 5e-7
"""Counts are kept in single precision, and what is left of one without a candidate's own share may
be far smaller.
"""


def anything(seed: int, n: int) -> Problem:
    """Return random passages, some without a known entry or block."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0, 40, n))
    zone = rng.integers(0, 4, n).astype(np.int32)
    arrivals = Arrivals(t, zone, CAMERAS[zone], np.full(n, 0.1), np.full(n, np.nan))
    own = np.where(rng.random(n) < 0.7, np.arange(n), -1).astype(np.int32)
    block = rng.integers(-1, 3, n).astype(np.int32)
    stay = rng.uniform(0.1, 4, n)
    order = np.argsort(t + stay)
    zone = np.where(own >= 0, (zone // 2) * 2 + rng.integers(0, 2, n), zone).astype(np.int32)
    since = np.where(own >= 0, t, -np.inf)
    departures = Departures(
        (t + stay)[order],
        zone[order],
        CAMERAS[zone[order]],
        since[order],
        np.full(n, np.nan),
        own[order],
        block[order],
    )
    return Problem(departures, arrivals, SHORT, 4, 60.0)


def surely(level: ContextLevel, found: Candidates, context: int) -> dict[int, float]:
    """Return sure transitions of a context by zone."""
    moved = level.transitions[[context]].tocoo()
    target = found.target[found.source == level.keys[context, 0]]
    return dict(zip(target[moved.coords[1]].tolist(), moved.data.tolist(), strict=True))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 14))
def test_counts_and_back_off_equal_their_slow_twin(seed: int, n: int) -> None:
    problem = anything(seed, n)
    found = find_candidates(problem)
    rng = np.random.default_rng(seed)
    m = len(found.lag)
    responsibility, share = rng.random(m) ** 3, rng.random(len(found.source))
    gone, leave = rng.random((2, n))
    contexts = Contexts(problem, 3)
    counted, leaving = contexts.count(found, responsibility, gone, leave)
    after = contexts.judged(found, responsibility, share, counted)
    levels = [level.published() for level in counted]
    slow = naive.contexts(
        *problem[:2],
        list(zip(found.departure.tolist(), found.arrival.tolist(), strict=True)),
        responsibility,
        share[found.pair],
        gone,
        leave,
        module.BACK_OFF_DEPARTURES,
        module.LIKELY_MIN,
    )
    assert after == pytest.approx(slow[1], abs=SINGLE)
    assert leaving == pytest.approx(slow[2])
    assert len(levels) == len(LEVELS) == 2
    for level, (n_of, moved_of) in zip(levels, slow[0], strict=True):
        assert level.transitions.nnz == sum(count > 0 for count in moved_of.values()), (
            "only what occurs is kept"
        )
        for k in range(len(level.keys)):
            key = tuple(level.keys[k].tolist())
            assert level.departures[k] == pytest.approx(n_of.get(key, 0.0))
            to = surely(level, found, k)
            assert list(to) == sorted(to)
            for target in range(4):
                assert to.get(target, 0.0) == pytest.approx(moved_of.get((key, target), 0.0))
        assert sum(level.departures) == pytest.approx(sum(n_of.values()))
        assert level.transitions.sum() == pytest.approx(sum(moved_of.values()))


def told(
    views: Views, true: dict[float, float]
) -> tuple[list[ContextLevel], Candidates, Departures, np.ndarray]:
    """Return the levels when identities are known.

    ``true`` maps the time of an exit to the time of the next appearance.
    """
    departures, arrivals = views.columns()
    zones = len(views.camera)
    problem = views.problem(LagBins(-20.0, 120.0))
    found = find_candidates(problem)
    right = np.array(
        [true.get(departures.t[d]) == arrivals.t[a] for d, a in zip(*found[:2], strict=True)], float
    )
    gone = 1.0 - np.minimum(np.bincount(found.departure, right, minlength=len(departures.t)), 1.0)
    left = np.maximum(np.bincount(departures.zone, minlength=zones), 1)
    share = np.bincount(found.pair, right, minlength=len(found.source)) / left[found.source]
    leave = (np.bincount(departures.zone, gone, minlength=zones) / left)[departures.zone]
    contexts = Contexts(problem, int(max(views.camera)) + 1)
    counted, _ = contexts.count(found, right, gone, leave)
    return (
        [level.published() for level in counted],
        found,
        departures,
        contexts.judged(found, right, share, counted),
    )


@pytest.mark.parametrize("known", ["entry", "block"])
def test_where_they_came_in_and_where_they_left_says_where_they_go(known: str) -> None:
    """From zone 2, those who entered at 0 (or left in block 7) go to zone 3, the
    others to zone 4.
    """
    rng = np.random.default_rng(0)
    views, true, firsts = Views([0, 0, 0, 1, 2]), {}, []
    for t in np.sort(rng.uniform(0, 20_000, 400)):
        if first := rng.random() < 0.5:
            firsts.append(t + 5)
        entry, block = (0 if first else 1, 7) if known == "entry" else (0, 7 if first else 8)
        views.through(t, t + 5, entry, 2, block)
        views.through(t + 15, t + 20, 3 if first else 4, 3 if first else 4)
        true[t + 5] = t + 15
    levels, found, departures, after = told(views, true)
    level = levels[LEVELS.index("entry+block")]
    context = {tuple(parts): k for k, (zone, *parts) in enumerate(level.keys.tolist()) if zone == 2}
    one, other = (
        (context[0, 7], context[1, 7]) if known == "entry" else (context[0, 7], context[0, 8])
    )
    assert surely(level, found, one)[3] == pytest.approx(level.departures[one])
    assert 4 not in surely(level, found, one)
    assert surely(level, found, other)[4] == pytest.approx(level.departures[other])
    candidate = found.source[found.pair] == 2
    is_first = np.isin(departures.t[found.departure[candidate]], firsts)
    to_three, share = found.target[found.pair[candidate]] == 3, after[candidate]
    assert (share[is_first & to_three] > 0.95).all()
    assert (share[~is_first & to_three] < 0.05).all()


def test_the_camera_before() -> None:
    """Of those at zone 2, all who came from camera 0 go to zone 3, and none of the others."""
    rng = np.random.default_rng(1)
    views, true = Views([0, 1, 2, 3, 4]), {}
    for t in np.sort(rng.uniform(0, 40_000, 300)):
        start, end = (0, 3) if rng.random() < 0.5 else (1, 4)
        for step, zone in enumerate((start, 2, end)):
            views.through(t + 20 * step, t + 20 * step + 5, zone, zone)
            if zone != end:
                true[t + 20 * step + 5] = t + 20 * step + 20
    levels, found, _, after = told(views, true)
    level = levels[LEVELS.index("previous")]
    (row,) = np.flatnonzero((level.keys[:, 0] == 2) & (level.keys[:, 1] == 0))
    assert surely(level, found, row)[3] == pytest.approx(level.departures[row])
    right = found.target[found.pair] > 2
    assert set(np.round(after[right]).tolist()) <= {0.0, 1.0}
    assert np.mean((after[right] > 0.9) | (after[right] < 0.1)) == 1.0
