"""What is worked out ahead for a prediction at the exit, against the longer way and against what it
was taken from.
"""

from __future__ import annotations

from itertools import accumulate

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from test_predictor import any_topology

from camtopod.predict import recent_events
from camtopod.predict.predictor import Predictor
from camtopod.predict.time_windows import quantiles, quantiles_beside
from camtopod.records import Event


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_at_the_exit_odds_and_windows_are_those_of_the_longer_way(seed: int) -> None:
    """Whatever the clocks, the passage, and what has come; the longer way is the one of who is
    asked later.
    """
    rng = np.random.default_rng(seed)
    topology = any_topology(rng)
    offsets = rng.choice([0.0, 3.0, -2.0], 3) * (rng.random() < 0.7)
    cameras = [
        replace(c, clock_offset=float(o)) for c, o in zip(topology.cameras, offsets, strict=True)
    ]
    predictor = Predictor(replace(topology, cameras=cameras))
    in_step = rng.random() < 0.3  # cameras that look once a second
    for t in np.sort(rng.uniform(0, 45, int(rng.integers(0, 40)))):
        t = np.floor(t) if in_step else t
        kind, track = "exit" if rng.random() < 0.3 else "entry", str(rng.integers(0, 4))
        event = Event(
            str(rng.choice(list("abc"))), kind, float(t), float(rng.choice([0.2, 0.8])), 0.55, track
        )
        predictor.observe(event)
    for zone, name in enumerate(zone.camera for zone in predictor.zones):
        ready = predictor._ready.of(zone)
        if ready is None:
            continue
        passage, left = predictor._under_way.get(name, "1"), 46.0 - predictor._ahead[name]
        known = predictor._at_exit(ready, left, passage)
        mass = predictor._odds(zone, ready, left, passage, observed=False)
        assert known.odds == pytest.approx(mass.sum(axis=1).tolist(), rel=1e-9)
        some = np.flatnonzero(mass.sum(axis=1) > 1e-9).tolist()
        pace = predictor._paces.of_passage(
            passage and passage.entry, zone, passage and left - passage.t
        )
        lags = quantiles(mass[some], predictor._hazards.bins.edges)
        assert [ready._lags(k, known) for k in some] == [
            pytest.approx(one, abs=1e-6) for one in lags
        ]
        assert [ready._lags(k, known) for k in some] == [
            pytest.approx(one, abs=1e-6) for one in lags
        ], "asked again"
        slowly = [ready.window(k, pace, usual) for k, usual in zip(some, lags, strict=True)]
        assert ready.windows(some, pace, known) == [
            pytest.approx(one, abs=0.0011) for one in slowly
        ]


@given(
    st.lists(st.floats(0.01, 1), min_size=5, max_size=5),
    st.floats(1e-6, 1),
    st.dictionaries(st.integers(0, 4), st.floats(0, 9)),
    st.integers(0, 3),
)
def test_the_window_of_one_target_is_that_among_many(
    still: list[float], share: float, came: dict[int, float], none_before: int
) -> None:
    """Of which some share is still to come, or nothing before some bin, and whatever came."""
    still = [0.0] * none_before + still[none_before:]
    mass = share * np.array(still)
    for at, more in came.items():
        mass[at] += more
    edges = [-2.0, -0.5, 0.0, 1.0, 3.0, 7.0]
    found = quantiles_beside([0.0, *accumulate(still)], share, sorted(came.items()), edges)
    assert found == pytest.approx(quantiles(mass[None], np.array(edges))[0], abs=1e-6)


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 3)), max_size=60))
def test_arrivals_by_zone_are_those_of_the_columns(came: list[tuple[int, int]]) -> None:
    """In whatever order they come, and however many have been dropped."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recent_events, "RECENT_MAX", 7)
        arrivals = recent_events.RecentArrivals()
        for n, (t, zone) in enumerate(came):
            arrivals.append(float(t), zone, float(n))
            counts = arrivals.dropped + arrivals.first
            for one, heard in arrivals.of_zone.items():
                assert heard == sorted(heard)
                assert len(heard) <= 14
                newest = [(float(s), k) for k, (s, v) in enumerate(came[: n + 1]) if v == one][-7:]
                known = [(s, k) for s, k in heard if k >= counts]
                assert known == sorted((s, k) for s, k in newest if k > n - 7)
                assert [arrivals.rate[k - arrivals.dropped] for _, k in known] == [
                    k for _, k in known
                ]
