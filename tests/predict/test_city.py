"""Predictions and matches in a city: by the part that owns the camera."""

from __future__ import annotations

import random

import pytest
from msgspec.structs import replace

from camtopod import CityPredictor, Event, Predictor, Topology, learn_topology
from camtopod.city.merge import merge
from camtopod.config import with_borders
from camtopod.predict import CityWalks, Walks, predicting
from camtopod.topology import UnknownPlace

CAMERAS = ("lobby", "hall", "yard", "gate")
OWNERS = {"lobby": "north", "hall": "north", "yard": "south", "gate": "south"}
DISTRICTS = with_borders(OWNERS, [("lobby", "hall"), ("hall", "yard"), ("yard", "gate")])


def walkers(count: int, seed: int) -> list[Event]:
    """Return the events of walkers through all cameras, either way."""
    chance, t, events = random.Random(seed), 1_700_000_000.0 + 1e5 * seed, []
    for number in range(count):
        t += chance.expovariate(1 / 40)
        came = t
        for camera in CAMERAS if chance.random() < 0.5 else CAMERAS[::-1]:
            left = came + chance.uniform(3, 5)
            events.append(Event(camera, "entry", came, 0.5, 0.5, str(number)))
            events.append(Event(camera, "exit", left, 0.5, 0.5, str(number)))
            came = left + chance.gauss(8, 1)
    return sorted(events, key=lambda event: event.t)


def heard(events: list[Event], site: str) -> list[Event]:
    cameras = {*DISTRICTS[site].cameras, *DISTRICTS[site].hears}
    return [event for event in events if event.camera in cameras]


@pytest.fixture(scope="module")
def city() -> Topology:
    events = walkers(300, 1)
    parts = [learn_topology(heard(events, site), site=site) for site in DISTRICTS]
    return merge(parts, DISTRICTS, "town").topology


def test_an_exit_is_answered_by_its_owners_part_alone(city: Topology) -> None:
    events = walkers(40, 2)
    predictor = CityPredictor(city)
    answers = []
    for event in events:
        if event.kind == "exit":
            answers.append(predictor.predict(event))
        predictor.observe(event)

    for part in city.parts or ():
        alone, expected = Predictor(part), []
        for event in heard(events, part.site):
            if event.kind == "exit" and OWNERS[event.camera] == part.site:
                expected.append(alone.predict(event))
            alone.observe(event)
        assert [x for x in answers if OWNERS[x.camera] == part.site] == expected
    assert {OWNERS[answers[0].camera], OWNERS[answers[0].next[0].camera]} <= {*DISTRICTS}
    assert any(x.camera == "hall" and x.next[0].camera == "yard" for x in answers)


def test_an_entry_is_matched_by_its_owners_part_alone(city: Topology) -> None:
    events = walkers(40, 2)
    walks = CityWalks(city)
    matches = [match for event in events if (match := walks.observe(event)) is not None]

    for part in city.parts or ():
        alone = Walks(part)
        answers = [alone.observe(event) for event in heard(events, part.site)]
        expected = [x for x in answers if x is not None and OWNERS[x.camera] == part.site]
        assert [x for x in matches if OWNERS[x.camera] == part.site] == expected
    assert any(x.camera == "yard" and x.from_ and x.from_[0].camera == "hall" for x in matches)


def test_a_camera_that_no_part_has_is_unknown(city: Topology) -> None:
    exit = Event("cellar", "exit", 1_700_000_000.0)
    predictor, walks = CityPredictor(city), CityWalks(city)

    predictor.observe(exit)
    with pytest.raises(UnknownPlace, match="no camera 'cellar'; there are"):
        predictor.predict(exit)
    with pytest.raises(ValueError, match="among what should be exit events"):
        predictor.predict(replace(exit, kind="entry"))
    [answer] = predicting(city)([exit])

    assert answer is not None
    assert (answer.leave, answer.next) == (1.0, [])
    assert walks.observe(exit) is None
    match = walks.observe(Event("cellar", "entry", 1_700_000_001.0))
    assert match is not None
    assert match.from_ == []


def test_a_city_and_a_topology_are_not_taken_for_each_other(city: Topology) -> None:
    part = replace((city.parts or [])[0], parts=[])

    for kind in (Predictor, Walks):
        with pytest.raises(ValueError, match="CityPredictor"):
            kind(city)
    for city_kind in (CityPredictor, CityWalks):
        with pytest.raises(ValueError, match="no city"):
            city_kind(part)
    assert Predictor(part).zones == part.zones
