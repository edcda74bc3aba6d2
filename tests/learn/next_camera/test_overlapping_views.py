"""Overlapping views: which overlap, and which passages elsewhere are of the leaving object."""

from __future__ import annotations

from collections.abc import Iterator

import naive
import numpy as np
import pytest
from hypothesis import given, strategies as st
from model_rows import rows_of
from synthetic_events import learned_from, passage

from camtopod.codec import decode_topology, to_json
from camtopod.learn.next_camera import overlapping_views
from camtopod.learn.next_camera.overlapping_views import find_overlapping
from camtopod.learn.traffic import Departures
from camtopod.predict.hand_over import cameras_to_watch
from camtopod.predict.predictor import Predictor
from camtopod.records import Event, InView, NextCamera, Prediction, Topology
from camtopod.topology.lag_bins import LAG_SCALE_SECONDS, LAG_STEP, offset_bins

BINS = offset_bins(LAG_SCALE_SECONDS, LAG_STEP)


def made(seed: int, n: int, cameras: int = 3, span: float = 300.0) -> Departures:
    """Return unrelated passages; some begin and end at the same instants."""
    rng = np.random.default_rng(seed)
    entered = np.floor(rng.uniform(0, span, n))
    left = entered + np.floor(rng.exponential(15.0, n))
    order = np.argsort(left, kind="stable")
    return passages_of(rng.integers(0, cameras, n)[order], entered[order], left[order])


def passages_of(camera: np.ndarray, entered: np.ndarray, left: np.ndarray) -> Departures:
    number = camera.astype(np.int32)
    return Departures.without_arrivals(left, number, number, entered, np.full(len(left), np.nan))


@given(st.integers(0, 10**6), st.integers(0, 30), st.sampled_from([0.0, -20.0, 7.0]))
def test_open_passages_equal_a_double_loop(seed: int, n: int, shift: float) -> None:
    passages = made(seed, n)
    with pytest.MonkeyPatch.context() as limits:
        limits.setattr(overlapping_views, "CANDIDATES_AT_ONCE", 5)
        found = [
            (exit_, passage)
            for part in overlapping_views._open(passages, slice(0, n), shift)
            for exit_, passage in zip(*part, strict=True)
            if passages.camera[exit_] != passages.camera[passage]
        ]
    assert len(found) == len(set(found))
    assert set(found) == naive.coexisting(passages.camera, passages.since, passages.t, shift)


def walkers(seed: int, objects: int, share: float = 1.0, seconds: float = 30.0) -> list[Event]:
    """Return walkers of which a share enters the view of b five seconds after that of a, and stays.

    Others come to b and c independently. One comes every so many ``seconds``.
    """
    rng = np.random.default_rng(seed)
    events: list[Event] = []

    for number in range(objects):
        t = float(rng.uniform(0, seconds * objects))
        events += passage("a", t, float(rng.uniform(8, 12)), f"a{number}")
        if rng.random() < share:
            events += passage(
                "b", t + float(rng.normal(5, 0.5)), float(rng.uniform(12, 25)), f"b{number}"
            )
        for camera in "bc":
            events += passage(
                camera,
                float(rng.uniform(0, seconds * objects)),
                float(rng.uniform(5, 40)),
                f"{camera}x{number}",
            )
    return sorted(events, key=lambda event: event.t)


def overlaps(topology: Topology) -> dict[tuple[str, str], float]:
    return {(row.camera, row.to): row.share for row in rows_of(topology).overlaps or []}


def predictions(topology: Topology, events: list[Event]) -> Iterator[tuple[Event, Prediction]]:
    predictor = Predictor(topology)
    for event in events:
        if event.kind == "exit":
            yield event, predictor.predict(event)
        predictor.observe(event)


@pytest.mark.parametrize("share", [1.0, 0.4])
def test_views_that_overlap_are_found_with_the_share_that_is_in_both(share: float) -> None:
    found = overlaps(learned_from(walkers(1, 200, share)))
    assert found.keys() == {("a", "b")}
    assert found["a", "b"] == pytest.approx(share, abs=0.15)


@pytest.mark.parametrize("seed", range(5))
def test_views_with_nothing_to_do_with_each_other_do_not_overlap(seed: int) -> None:
    """Nor if all traffic comes in platoons of a minute every five minutes."""
    rng = np.random.default_rng(seed)
    begun = 300.0 * rng.integers(0, 60, 1500) + rng.normal(0, 25, 1500)
    left = begun + rng.uniform(5, 40, 1500)
    order = np.argsort(left)
    passages = passages_of(rng.integers(0, 6, 1500)[order], begun[order], left[order])
    assert find_overlapping(passages, 6, BINS) == []


def test_who_leaves_a_view_is_looked_for_where_another_sees_it() -> None:
    topology, right, sure = learned_from(walkers(1, 200)), [], []
    for exit_, told in predictions(decode_topology(to_json(topology)), walkers(2, 100)):
        if exit_.camera != "a":
            assert told.look is None is told.in_view, "no view overlaps"
            continue
        assert told.look
        assert told.in_view
        assert told.look[0].camera == "b"
        assert all(0.0 < one.probability <= 1.0 for one in (*told.look, *told.in_view))
        assert [one.probability for one in told.in_view] == sorted(
            (x.probability for x in told.in_view), reverse=True
        )
        assert sum(one.probability for one in told.in_view) <= 1.0 + 1e-9, (
            "of one camera's passages one is right"
        )
        right.append(told.in_view[0].track == str(exit_.track).replace("a", "b"))
        sure.append(told.in_view[0].probability)
    assert np.mean(right) > 0.9
    assert np.mean(sure) == pytest.approx(np.mean(right), abs=0.1)


@pytest.mark.parametrize("where", range(3))
def test_passages_in_view_do_not_depend_on_the_order_of_lines_of_one_instant(where: int) -> None:
    """An object that leaves another view at that instant still counts, one that enters does not."""
    topology, t = learned_from(walkers(1, 200)), 1e6
    before = [
        Event(camera, "entry", t - ago, track=str(ago))
        for camera, ago in (("a", 10), ("b", 5), ("b", 4))
    ]
    at_once = [Event("b", "exit", t, track="5"), Event("b", "entry", t, track="6")]
    at_once.insert(where, Event("a", "exit", t, track="10"))
    told = next(p for exit_, p in predictions(topology, [*before, *at_once]) if exit_.camera == "a")
    assert told.in_view is not None
    assert {one.track for one in told.in_view} == {"5", "4"}
    assert told.in_view[0].probability > 0.5


def test_where_nobody_sees_an_object_the_next_camera_counts() -> None:
    following = [
        NextCamera("c", "c/1", 0.6, 1.0, 2.0, 3.0),
        NextCamera("b", "b/1", 0.2, 1.0, 2.0, 3.0),
    ]
    in_view = [InView("b", "1", 0.0, 0.5), InView("d", "2", 0.0, 0.2)]
    said = {one.camera: one.probability for one in cameras_to_watch(in_view, following)}
    assert said == pytest.approx({"b": 0.5 + 0.4 * 0.2, "c": 0.4 * 0.6, "d": 0.2})
    assert [one.camera for one in cameras_to_watch([], following)] == ["c", "b"]
