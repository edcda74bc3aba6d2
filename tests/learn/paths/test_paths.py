"""The second opinion finds paths of any length, and prediction averages it with the first."""

from __future__ import annotations

from typing import Any

import naive
import numpy as np
import pytest
from model_rows import CameraPath, rows_of, with_rows
from msgspec.structs import replace
from synthetic_events import learned_from

from camtopod.arrays import Floats
from camtopod.client import Gate
from camtopod.learn import refit
from camtopod.learn.learner import Learner
from camtopod.learn.links import PathEvidence, tabulate, with_second_opinion
from camtopod.learn.links.link_table import AGREEMENT_NATS, Transitions
from camtopod.learn.paths import second_opinion
from camtopod.learn.paths.camera_lags import camera_lags
from camtopod.learn.traffic import Scene
from camtopod.learn.traffic.events import Arrivals, Departures
from camtopod.predict import Predictor
from camtopod.predict.second_opinion import PATHS_WEIGHT_MAX
from camtopod.records import (
    Event,
    Topology,
)
from camtopod.topology import LagBins, student_density, student_share

BINS = LagBins(-120.0, 180.0)


def events(seed: int = 0) -> list[Event]:
    """Return passages: seven in ten go from a to b in 200 s, half of these on to c in 5 s."""
    rng = np.random.default_rng(seed)
    made = []
    for k, t in enumerate(np.cumsum(rng.exponential(30.0, 200))):
        went, on = rng.random(2) < (0.7, 0.5)
        ways = [("a", t), ("b", t + rng.normal(204, 2)), ("c", t + rng.normal(213, 2))]
        for camera, began in ways[: 1 + went + (went and on)]:
            made.append(Event(camera, "entry", began, track=f"{k}"))
            made.append(Event(camera, "exit", began + 4.0, track=f"{k}"))
    return sorted(made, key=lambda event: event.t)


@pytest.fixture(scope="module")
def topology() -> Topology:
    return learned_from(events())


def paths_of(topology: Topology) -> list[CameraPath]:
    return rows_of(topology).paths or []


def with_paths(topology: Topology, paths: list[CameraPath] | None) -> Topology:
    """Return the version with these paths, and without links, so that the paths count most."""
    return with_rows(replace(topology, links=[]), paths=paths)


def test_a_long_path_and_a_short_one_are_found(topology: Topology) -> None:
    found = {(one.from_, one.to): one for one in paths_of(topology) if one.share > 0.3}
    assert found.keys() == {("a", "b"), ("b", "c")}
    long, short = found["a", "b"], found["b", "c"]
    assert long.place == pytest.approx(200.0, abs=1.0)
    assert long.share == pytest.approx(0.7, abs=0.08)
    assert long.width < 4.0
    assert short.place == pytest.approx(5.0, abs=1.0)
    assert short.share == pytest.approx(0.5, abs=0.1)


def test_each_opinion_has_its_weight(topology: Topology) -> None:
    """Of an exit of which nothing else is known."""
    path = CameraPath("a", "c", 0.9, 300.0, 1.0)
    exit_ = Event("a", "exit", 1e6)
    said = []
    for paths in (None, [path]):
        predictor = Predictor(with_paths(topology, paths))
        predictor.prepared.anywhere.unknown[:] = 0.0
        said.append(predictor.predict(exit_))
    alone, both = said
    assert both.leave == pytest.approx(
        (1 - PATHS_WEIGHT_MAX) * alone.leave + PATHS_WEIGHT_MAX * 0.1, abs=1e-3
    )
    [far] = [one for one in both.next if one.q50 > 250.0]
    assert far.probability == pytest.approx(PATHS_WEIGHT_MAX * 0.9, abs=1e-3)
    assert far.q50 == pytest.approx(300.0, abs=0.2)
    assert far.q90 - far.q10 == pytest.approx(2 * 1.476, abs=0.3)


def test_where_links_are_published_paths_count_less(topology: Topology) -> None:
    [link] = [one for one in topology.links if (one.from_, one.to) == ("a/1", "b/1")]
    paths = [CameraPath("a", "c", 0.9, 300.0, 1.0)]
    likeliest = []
    for links in ([], [link]):
        both = replace(with_paths(topology, paths), links=links)
        said = Predictor(both).predict(Event("a", "exit", 1e6))
        likeliest.append(sum(one.probability for one in said.next if one.q50 > 250.0))
    assert likeliest[1] < 0.2 < 0.4 < likeliest[0]


def test_a_path_that_is_over_is_ruled_out_later(topology: Topology) -> None:
    paths = [CameraPath("a", "c", 0.9, 300.0, 1.0)]
    predictor = Predictor(with_paths(topology, paths))
    exit_ = Event("a", "exit", 1e6)
    assert predictor.predict(exit_, now=1e6 + 290.0).leave < 0.6
    assert predictor.predict(exit_, now=1e6 + 320.0).leave > 0.9


def test_a_gate_knows_both_opinions(topology: Topology) -> None:
    paths = [CameraPath("a", "c", 0.9, 300.0, 1.0)]
    gate = Gate(with_paths(topology, paths))
    assert gate.gate_gone("a/1", 0.0) == pytest.approx(0.0, abs=0.02)
    t = np.arange(290.0, 310.0, 0.1)
    appear = sum(np.exp(gate.gate("a/1", 0.0, "c", at)) * 0.1 for at in t)
    assert appear == pytest.approx(0.9 * PATHS_WEIGHT_MAX, abs=0.01)
    assert gate.gate("a/1", 0.0, "c", 300.0) > np.log(0.9 * PATHS_WEIGHT_MAX * 0.3)


def test_lags_equal_their_slow_twin() -> None:
    rng = np.random.default_rng(3)
    t, left = np.sort(rng.uniform(0, 600, 60)), np.sort(rng.uniform(0, 600, 50))
    camera, source = rng.integers(0, 3, 60), rng.integers(0, 3, 50)
    dwell = rng.exponential(20.0, 50)
    unknown = np.full(50, -1, np.int32)
    lags = camera_lags(
        Departures(left, source * 0, source.astype(np.int32), left - dwell, left, unknown, unknown),
        Arrivals(t, camera * 0, camera.astype(np.int32), t, t),
        3,
        -30.0,
        600.0,
    )
    found = list(zip(lags.departure.tolist(), lags.arrival.tolist(), strict=True))
    assert sorted(found) == naive.camera_lags(left, source, dwell, t, camera, -30.0, lags.lag_max)
    pair, low, high = (
        np.array([5, 2, 5, 5]),
        np.array([-4.0, 0, 60, -9]),
        np.array([80.0, 9, 99, 0]),
    )
    number, row, rows = lags.within(pair, low, high)
    assert rows.tolist() == sorted({*rows.tolist()})
    in_range = [(k, *found[rows[at]]) for k, at in zip(number.tolist(), row.tolist(), strict=True)]
    assert sorted(in_range) == [
        (k, d, a)
        for k in range(len(pair))
        for d, a in sorted(found)
        if 3 * source[d] + camera[a] == pair[k] and low[k] <= t[a] - left[d] <= high[k]
    ]
    assert [len(column) for column in lags.within(pair[:0], low[:0], high[:0])] == [0, 0, 0]


def test_share_and_density_of_student_agree() -> None:
    x = np.linspace(-40.0, 60.0, 100_001)
    density = student_density(x, np.full(len(x), 3.0), np.full(len(x), 2.0))
    assert np.cumsum(density)[60_000] * 1e-3 == pytest.approx(
        float(student_share(x, 3.0, 2.0)[60_000]), abs=1e-3
    )


# --- evidence for links ---


def evidence_of(events: list[Event]) -> tuple[list[str], Floats]:
    """Return the cameras of a recording, and the second opinion's evidence for each pair."""
    learner, seen = Learner(only_last=True), dict[str, Any]()

    def asked(scene: Scene, cameras: list[str], *others: Any) -> Any:
        paths, nats = second_opinion(scene, cameras, *others)
        seen.update(cameras=cameras, nats=nats)
        return paths, nats

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(refit, "second_opinion", asked)
        for event in events:
            learner.receive(event)
        learner.flush()
    size, paths = len(seen["cameras"]), seen["nats"]
    table = np.zeros((size, size))
    np.add.at(table, (paths.source, paths.target), paths.nats)
    return seen["cameras"], table


def test_its_evidence_is_large_for_ways_and_small_for_chance() -> None:
    cameras, nats = evidence_of(events())
    a, b, c = (cameras.index(name) for name in "abc")
    assert nats[a, b] > 20
    assert nats[b, c] > 20
    assert max(nats[b, a], nats[c, b], nats[c, a]) < 5

    rng, alone = np.random.default_rng(1), list[Event]()
    for camera in "abcd":
        for k, t in enumerate(rng.uniform(0.0, 1200.0, 400)):
            alone.append(Event(camera, "entry", t, track=f"{k}"))
            alone.append(Event(camera, "exit", t + 10.0, track=f"{k}"))
    assert evidence_of(sorted(alone, key=lambda event: event.t))[1].max() < 7


def test_it_counts_where_the_zones_agree() -> None:
    """Of each pair of cameras, for the pair of zones with the most transitions."""
    lag = np.full(300, 10.0)
    source, target = np.repeat([0, 1, 2], 100).astype(np.int32), np.full(300, 3, np.int32)
    weight = np.repeat([0.9, 0.5, 0.9], 100)
    flat = np.where(np.arange(300) < 200, 0.5, 1.0)
    table = tabulate(
        Transitions(source, target, lag, weight, flat), np.full((4, 1), 200.0), BINS, 4
    )
    camera = np.array([0, 0, 1, 2], np.int32)
    paths = PathEvidence(
        np.array([0, 0, 1]),
        np.array([2, 2, 2]),
        np.array([10.5, 40.0, 10.0]),
        np.ones(3),
        np.array([7.0, 9.0, 8.0]),
    )
    both = with_second_opinion(table, paths, camera, 4)
    assert both.ratio - table.ratio == pytest.approx([7.0, 0.0, 0.0]), "not what is at another lag"
    assert table.ratio[0] > AGREEMENT_NATS > table.ratio[2]
