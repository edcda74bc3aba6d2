"""Long paths: found in correlograms of cameras, learned around their lag, predicted and drawn."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from synthetic_events import learned_from

from camtopod.arrays import Ints
from camtopod.client.gate import Gate
from camtopod.codec import decode_topology, to_json
from camtopod.learn.association import Problem, exposures, find_candidates
from camtopod.learn.long_paths import find_long_paths, long_ranges
from camtopod.learn.traffic.events import Arrivals, Departures
from camtopod.predict.outlook import Departure
from camtopod.predict.predictor import Predictor
from camtopod.records import Event, Link, Topology
from camtopod.topology import LagBins
from camtopod.web.explanations import Explanations

T0 = 1e6
WALKS = 700
SPAN_SECONDS = 6 * 3600.0
LAG_MAX = 180.0
STAY_SECONDS = 6.0


def site(
    seed: int, lags: dict[tuple[str, str], tuple[float, float]], alone: str = "abc"
) -> list[Event]:
    """Return walks past the first camera of each pair, then the second, ``lags`` (mean, sd) later.

    As many objects pass each of the cameras ``alone`` and no other.
    """
    chance, events, track = np.random.default_rng(seed), list[Event](), itertools.count()

    def passage(camera: str, t: float) -> float:
        name = str(next(track))
        left = t + chance.uniform(0.5, 1.5) * STAY_SECONDS
        events.extend(
            (Event(camera, "entry", t, track=name), Event(camera, "exit", left, track=name))
        )
        return left

    for source, target in lags:
        mean, sd = lags[source, target]
        for start in chance.uniform(T0, T0 + SPAN_SECONDS, WALKS):
            passage(target, passage(source, start) + chance.normal(mean, sd))
    for camera in alone:
        for start in chance.uniform(T0, T0 + SPAN_SECONDS, WALKS):
            passage(camera, start)
    return sorted(events, key=lambda event: event.t)


def between(topology: Topology) -> dict[tuple[str, str], Link]:
    return {
        (one.from_, one.to): one
        for one in topology.links
        if one.relation != "visible" and one.from_ != one.to
    }


@pytest.fixture(scope="module")
def far_and_near() -> Topology:
    """Return transitions from a to b in five minutes and from b to c in twenty seconds."""
    return learned_from(site(1, {("a", "b"): (300.0, 6.0), ("b", "c"): (20.0, 2.0)}, "abc"))


def test_a_way_of_five_minutes_is_found_beside_one_of_seconds(far_and_near: Topology) -> None:
    links = between(far_and_near)
    assert set(links) == {("a/1", "b/1"), ("b/1", "c/1")}
    far = links["a/1", "b/1"].transit
    assert far.q50 == pytest.approx(300.0, abs=2.0)
    assert far.mean == pytest.approx(300.0, abs=2.0)
    assert far.mode == pytest.approx(300.0, abs=4.0)
    assert far.q10 == pytest.approx(300.0 - 1.28 * 6.0, abs=5.0)
    assert far.q90 == pytest.approx(300.0 + 1.28 * 6.0, abs=10.0), "unrelated arrivals among them"
    assert links["a/1", "b/1"].probability == pytest.approx(0.5, abs=0.1), (
        "half of those at a came alone"
    )
    [pair] = [one for one in far_and_near.pairs if one.cameras == ("a", "b")]
    assert pair.relation == "unseen_path"


def test_it_is_foretold_in_its_window_and_gone_when_that_is_over(far_and_near: Topology) -> None:
    predictor, exit_at = Predictor(far_and_near), T0 + SPAN_SECONDS + 1000.0
    exit_ = Event("a", "exit", exit_at)
    likeliest = predictor.predict(exit_).next[0]
    assert (likeliest.camera, likeliest.q50) == ("b", pytest.approx(300.0, abs=3.0))
    assert likeliest.probability == pytest.approx(0.5, abs=0.08)
    assert 285.0 < likeliest.q10 < 297.0
    assert 303.0 < likeliest.q90 < 345.0, "the range is wider than this way"
    still = predictor.predict(exit_, now=exit_at + 250.0)
    assert still.next[0].camera == "b"
    assert still.next[0].probability > 0.4
    assert predictor.predict(exit_, now=exit_at + 400.0).leave > 0.9


def test_who_arrives_in_time_is_probably_the_one_who_left(far_and_near: Topology) -> None:
    predictor, exit_at = Predictor(far_and_near), T0 + SPAN_SECONDS + 1000.0
    predictor.observe(Event("a", "exit", exit_at))
    predictor.observe(Event("b", "entry", exit_at + 300.0, track="x"))
    [passage] = predictor._memory.passages.open.of("b").values()
    seen = predictor._memory.seen(Departure(passage.entry, exit_at + 310.0, passage))
    assert seen.previous == "a"
    assert seen.sure > 0.3, "as many come from elsewhere"

    gate = Gate(far_and_near)
    entries = [Event("b", "entry", exit_at + lag) for lag in (1.0, 150.0, 300.0, 450.0)]
    [odds] = gate.affinity([Event("a", "exit", exit_at)], entries)
    assert odds.argmax() == 2
    assert odds[2] > 0.0
    assert (odds[[0, 1, 3]] < 0.0).all()
    assert gate.gate("a/1", exit_at, "b", exit_at + 300.0) > gate.gate(
        "a/1", exit_at, "b", exit_at + 320.0
    )
    assert gate.gate_gone("a/1", 200.0) > gate.gate_gone("a/1", 400.0)


def test_a_version_says_by_how_much_its_lags_are_delayed(far_and_near: Topology) -> None:
    assert decode_topology(to_json(far_and_near)) == far_and_near
    link = between(far_and_near)["a/1", "b/1"]
    assert link.histogram is not None
    assert link.histogram.delay == pytest.approx(300.0, abs=10.0)
    near = between(far_and_near)["b/1", "c/1"]
    assert b"delay" not in to_json(near), "as versions were before there were long ways"
    story = Explanations(far_and_near).link("a/1", "b/1", link.relation)
    assert story is not None
    chart = story["chart"]
    assert np.median(chart["samples"]) == pytest.approx(300.0, abs=5.0)
    assert chart["delay"] == link.histogram.delay


def ends(events: list[Event], cameras: str = "abc") -> tuple[Departures, Arrivals]:
    """Return departures and arrivals of cameras with a zone each."""
    sides = []
    for kind in ("exit", "entry"):
        some = [event for event in events if event.kind == kind]
        t, camera = (
            np.array([e.t for e in some]),
            np.array([cameras.index(e.camera) for e in some], np.int32),
        )
        sides.append((t, camera))
    (left, source), (came, target) = sides
    unknown = np.full(len(left), np.nan)
    departures = Departures.without_arrivals(left, source, source, left - STAY_SECONDS, unknown)
    return departures, Arrivals(
        came, target, target, np.ones(len(came)), np.full(len(came), np.nan)
    )


@pytest.mark.parametrize("seed", range(4))
def test_cameras_that_have_nothing_to_do_with_each_other_have_no_long_way(seed: int) -> None:
    assert find_long_paths(*ends(site(seed, {}, "abc" * 2)), 3) == []


@pytest.mark.parametrize("seconds", [75.0, 150.0, 300.0, 600.0])
def test_a_sharp_peak_is_found_wherever_it_is(seconds: float) -> None:
    [way] = find_long_paths(*ends(site(3, {("a", "b"): (seconds, 3.0)})), 3)
    assert way[:2] == (0, 1)
    assert way[2] == pytest.approx(seconds, abs=4.0)


def test_a_way_is_found_in_a_window_that_is_longer_than_the_correlograms() -> None:
    """Of a thousand cameras, they cover two hours of the six; both halves have to show the way."""
    [way] = find_long_paths(*ends(site(3, {("a", "b"): (300.0, 3.0)})), 1024)
    assert way == (0, 1, pytest.approx(300.0, abs=4.0))


def test_a_way_is_found_between_cameras_that_see_exits_only_and_entries_only() -> None:
    departures, arrivals = ends(site(3, {("a", "b"): (300.0, 3.0)}))
    exits = departures.take(departures.camera == 0, np.zeros(len(arrivals.t), np.bool_))
    [way] = find_long_paths(exits, arrivals.take(arrivals.camera == 1), 3)
    assert way == (0, 1, pytest.approx(300.0, abs=4.0))


def test_a_near_or_a_broad_way_is_left_to_the_lag_bins() -> None:
    assert find_long_paths(*ends(site(4, {("a", "b"): (30.0, 3.0)})), 3) == []
    assert find_long_paths(*ends(site(4, {("a", "b"): (100.0, 30.0)})), 3) == []


def test_a_way_over_a_camera_between_is_none_of_its_own() -> None:
    chance, events = np.random.default_rng(5), list[Event]()
    for k, start in enumerate(chance.uniform(T0, T0 + SPAN_SECONDS, WALKS)):
        t = float(start)
        for camera, lag in (("a", 0.0), ("b", 110.0), ("c", 100.0)):
            t += chance.normal(lag, 3.0) if lag else 0.0
            events.append(Event(camera, "entry", t, track=f"{camera}{k}"))
            t += STAY_SECONDS
            events.append(Event(camera, "exit", t, track=f"{camera}{k}"))
    events.sort(key=lambda event: event.t)
    assert [way[:2] for way in find_long_paths(*ends(events), 3)] == [(0, 1), (1, 2)]
    assert set(between(learned_from(events))) == {("a/1", "b/1"), ("b/1", "c/1")}


def test_a_group_that_walks_along_once_makes_no_link() -> None:
    events = site(6, {}, "abc")
    for k in range(12):
        for camera, t in (("a", T0 + 500.0 + 0.2 * k), ("b", T0 + 900.0 + 0.2 * k)):
            events += [
                Event(camera, "entry", t - 5.0, track=f"g{k}"),
                Event(camera, "exit", t, track=f"g{k}"),
            ]
    assert not between(learned_from(sorted(events, key=lambda event: event.t)))


@pytest.mark.parametrize("camera", [[0, 0, 1, 2], [2, 1, 0, 0]])
def test_lags_of_long_paths_are_delayed_and_no_others(camera: list[int]) -> None:
    view = np.array(camera, np.int32)  # of each zone
    departures, arrivals = ends(site(3, {("a", "b"): (300.0, 3.0)}))
    chance = np.random.default_rng(1)

    def spread(seen: Ints) -> Ints:
        """Return a zone of each event's camera."""
        zones = [chance.choice(np.flatnonzero(view == one)) for one in seen.tolist()]
        return np.array(zones, np.int32)

    departures = departures._replace(zone=spread(departures.camera))
    arrivals = arrivals._replace(zone=spread(arrivals.camera))
    problem = Problem(departures, arrivals, LagBins(-120.0, LAG_MAX), 4, T0 + SPAN_SECONDS)

    ranges = long_ranges(problem, view, 10_000_000)

    assert ranges is not None
    problem = problem._replace(ranges=ranges)
    source, target = (zone.ravel().astype(np.int32) for zone in np.indices((4, 4)))
    is_long = (view[source] == 0) & (view[target] == 1)
    seconds = problem.delays(source, target)
    assert seconds[is_long] == pytest.approx(300.0, abs=4.0)
    assert not seconds[~is_long].any()
    assert (ranges.zone[problem.range_of(source, target)] == source).all()

    c = find_candidates(problem)
    after = problem.delays(departures.zone[c.departure], arrivals.zone[c.arrival])
    lag = arrivals.t[c.arrival] - departures.t[c.departure]
    assert c.lag == pytest.approx(lag, abs=1e-3)
    assert (lag - after >= -120.0).all()
    assert (lag - after <= LAG_MAX).all()
    for lags, long in ((lag[after > 0.0], True), (lag[after == 0.0], False)):
        apart = arrivals.t[:, None] - departures.t
        far = (departures.camera == 0) & (arrivals.camera == 1)[:, None]
        inside = (far == long) & (apart - seconds.max() * long <= LAG_MAX)
        inside &= apart >= seconds.max() - 120.0 if long else apart > 0.0
        assert int((lags > 0.0).sum()) == int(inside.sum())

    exposed = exposures(problem)
    counted = problem._replace(ranges=None)
    assert exposed[:4] == pytest.approx(exposures(counted))
    for number in range(4, len(exposed)):
        t = departures.t[departures.zone == ranges.zone[number]] + ranges.delay[number]
        edges = problem.bins.edges[1:]
        least = np.where(edges > 0.0, (problem.until - t[:, None] >= edges).sum(axis=0), len(t))
        assert exposed[number] == pytest.approx(least)
