"""The range of lags: found from the events, short on fast sites and long on slow ones."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from msgspec.structs import replace
from synthetic_events import learned_from, passage

from camtopod.learn import lag_range
from camtopod.learn.association import screening
from camtopod.learn.learner import Learner
from camtopod.learn.limits import LONGEST_SECONDS
from camtopod.learn.settings import Settings
from camtopod.records import Event, Topology
from camtopod.topology import LagBins, longest_lag, masses_on_bins

T0 = 1e6
HOUR = 3600.0
WALKS = 80  # an hour
CAMERAS = "abcdef"
STAY_SECONDS = 5.0


def site(
    seconds: float, hours: float, seed: int = 1, begin: float = T0, detour: float | None = None
) -> list[Event]:
    """Return walks along cameras, ``seconds`` from one to the next; most pass all of them.

    detour: seconds of the way from c to d, if it is another.
    """
    chance, events = np.random.default_rng(seed), list[Event]()
    starts = np.sort(chance.uniform(begin, begin + hours * HOUR, int(WALKS * hours)))
    for k, start in enumerate(starts.tolist()):
        t, first, last = start, 0, len(CAMERAS)
        if chance.random() < 0.3:
            first, last = sorted(chance.choice(last + 1, 2, replace=False).tolist())
        for camera in CAMERAS[first:last]:
            events += passage(camera, t, STAY_SECONDS, f"{seed}-{k}")
            mean = detour if camera == "c" and detour else seconds
            t += STAY_SECONDS + mean * chance.lognormal(0.0, 0.1)
    return sorted(events, key=lambda event: event.t)


def reach(topology: Topology) -> float:
    return longest_lag(topology)


@pytest.mark.parametrize(("seconds", "least", "most"), [(12.0, 60.0, 67.0), (150.0, 200.0, 500.0)])
def test_the_range_is_that_of_the_ways(seconds: float, least: float, most: float) -> None:
    topology = learned_from(site(seconds, 4.0))
    assert least <= reach(topology) <= most
    ways = {(link.from_[0], link.to[0]) for link in topology.links if link.relation != "visible"}
    assert ways == set(pairwise(CAMERAS))


def test_a_way_that_becomes_a_detour_of_ten_minutes_is_found_within_an_hour() -> None:
    hours = 2.0
    before = site(12.0, hours)
    after = site(12.0, 1.0, 2, T0 + hours * HOUR, detour=600.0)
    events = sorted([*before, *after], key=lambda event: event.t)
    learner = Learner()
    for event in events:
        if event.t < T0 + (hours + 1.0) * HOUR:
            learner.receive(event)
    learner.flush()

    versions = learner.updates()
    first = [one for one in versions if T0 + 1800.0 < one.as_of <= T0 + hours * HOUR]
    assert first
    assert max(map(reach, first)) < 70.0, "a short range until then"
    newest = versions[-1]
    assert reach(newest) > 700.0
    [way] = [link for link in newest.links if (link.from_, link.to) == ("c/1", "d/1")]
    assert way.histogram is not None
    model = newest.model
    assert model is not None
    bins = LagBins(model.lag_min, model.lag_max)
    mass = masses_on_bins(way.histogram, bins)
    assert mass[bins.edges[:-1] > 300.0].sum() > 8.0, "of some forty who have arrived by then"


def test_the_range_of_a_large_site_is_that_of_its_ways(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is looked for in some of its parts, as the whole has too many pairs of zones."""
    houses = range(5)
    for module in (lag_range, screening):
        monkeypatch.setattr(module, "PAIRS_FEW", (len(houses) * len(CAMERAS)) ** 2 - 1)
    monkeypatch.setattr(lag_range, "NEIGHBOURHOOD_ZONES_MAX", len(CAMERAS))
    walks = {house: site(240.0, 1.0, seed=house) for house in houses}
    events = [
        replace(event, camera=f"{event.camera}{house}", track=f"{house} {event.track}")
        for house in houses
        for event in walks[house]
    ]
    topology = learned_from(sorted(events, key=lambda event: event.t))

    assert 300.0 <= reach(topology) <= 1000.0
    links = (link for link in topology.links if link.relation != "visible")
    ways = {(link.from_.split("/")[0], link.to.split("/")[0]) for link in links}
    true_ways = {(f"{a}{house}", f"{b}{house}") for a, b in pairwise(CAMERAS) for house in houses}
    assert ways <= true_ways
    assert len(ways) >= 0.8 * len(true_ways)


def test_a_large_site_without_ways_has_the_shortest_range(monkeypatch: pytest.MonkeyPatch) -> None:
    """No part of it has both departures and arrivals."""
    monkeypatch.setattr(lag_range, "PAIRS_FEW", 1)
    monkeypatch.setattr(lag_range, "NEIGHBOURHOOD_ZONES_MAX", 1)
    events = [
        Event(camera, kind, T0 + 60.0 * k, 0.5, 0.5)
        for k in range(200)
        for camera, kind in (("a", "entry"), ("b", "exit"))
    ]
    shortest = lag_range.shortest_bins().lag_max
    assert reach(learned_from(events)) == pytest.approx(shortest)


def test_a_large_site_has_entries_at_few_cameras_and_a_camera_without_events(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The first camera's events have left the window, so that it has no zone."""
    monkeypatch.setattr(lag_range, "PAIRS_FEW", 1)
    monkeypatch.setattr(lag_range, "NEIGHBOURHOOD_ZONES_MAX", 1)
    events = [Event("first", "exit", T0)]
    for k in range(1, 100):
        events += [Event("a", "exit", T0 + 60.0 * k), Event("b", "entry", T0 + 60.0 * k + 5.0)]
    learner = Learner(Settings(window_events=100, window_camera_events=0), only_last=True)
    for event in events:
        learner.receive(event)
    learner.flush()
    assert learner.topology is not None
    assert [camera.zones for camera in learner.topology.cameras] == [["a/1"], ["b/1"], []]
    assert reach(learner.topology) == pytest.approx(lag_range.shortest_bins().lag_max)


def test_a_moment_with_too_many_events_has_no_say(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lag_range, "EVENT_PAIRS_MAX", 99)
    events = [Event(*event, T0) for event in (("a", "exit"), ("b", "entry"))]
    events = [replace(event, x=k / 20.0, y=0.5) for event in events for k in range(20)]
    shortest = lag_range.shortest_bins().lag_max
    assert reach(learned_from(events)) == pytest.approx(shortest)


def test_an_overlap_is_within_the_range_before_the_exit() -> None:
    chance, events = np.random.default_rng(3), list[Event]()
    for k, t in enumerate(np.sort(chance.uniform(T0, T0 + 2.0 * HOUR, 300)).tolist()):
        events += passage("a", t, 40.0, str(k))
        events += passage("b", t + 40.0 - chance.normal(20.0, 3.0), 30.0, f"b{k}")
    model = learned_from(sorted(events, key=lambda event: event.t)).model
    assert model is not None
    assert -90.0 < model.lag_min < -40.0


def test_before_the_exit_the_range_covers_the_stays_in_views_that_overlap(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """People stand about where two views overlap, and no link stands out yet."""
    monkeypatch.setattr(lag_range, "extremes", lambda problem, fit: (0.0, 0.0))
    chance, events = np.random.default_rng(5), list[Event]()
    for k, t in enumerate(np.sort(chance.uniform(T0, T0 + HOUR, 400)).tolist()):
        stay = chance.exponential(30.0)
        events += passage("a", t, stay, str(k))
        events += passage("b", t + chance.uniform(0.0, 2.0), stay, f"b{k}")
    model = learned_from(sorted(events, key=lambda event: event.t)).model
    assert model is not None
    assert -110.0 < model.lag_min < -75.0, "of exponential stays, 95 % are shorter than 90 s"


def test_a_range_ends_at_the_edges_of_bins() -> None:
    for after in (61.3, 180.0, 777.7, LONGEST_SECONDS[1]):
        bins = lag_range._bins(5.0, after)
        assert bins.edges[0] == pytest.approx(bins.lag_min, abs=0.003)
        assert bins.edges[-1] == pytest.approx(bins.lag_max, abs=0.003)
        assert bins.lag_max >= after
        assert bins.size == len(LagBins(-5.0, after).widths)


def test_what_is_spread_over_all_lags_does_not_widen_the_range() -> None:
    """Busy unrelated cameras beside a way of seconds."""
    chance, events = np.random.default_rng(4), site(12.0, 3.0)
    for k, t in enumerate(np.sort(chance.uniform(T0, T0 + 3.0 * HOUR, 1500)).tolist()):
        events += passage("xy"[k % 2], t, STAY_SECONDS, f"x{k}")
    assert reach(learned_from(sorted(events, key=lambda event: event.t))) < 70.0
