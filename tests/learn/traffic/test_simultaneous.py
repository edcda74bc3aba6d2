"""Cameras with simultaneous frames: entries into several views coincide, none is earlier."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from synthetic_events import learned_from, passage

from camtopod.predict.predictor import Predictor
from camtopod.records import Event

Line = Callable[[Event], object]


def in_step(objects: int, seed: int) -> list[Event]:
    """Return objects that enter the views of a and b at one instant, and leave a before b.

    Camera c is unrelated. There are two frames a second.
    """
    rng = np.random.default_rng(seed)
    events: list[Event] = []
    for number in range(objects):
        t = np.floor(2 * rng.uniform(0, 20.0 * objects)) / 2
        stay = np.floor(2 * rng.uniform(2, 5)) / 2
        longer = stay + np.floor(2 * rng.uniform(2, 8)) / 2
        other = np.floor(2 * rng.uniform(0, 20.0 * objects)) / 2
        for camera, entered, seconds in (("a", t, stay), ("b", t, longer), ("c", other, 4.0)):
            events += passage(camera, float(entered), float(seconds), str(number))
    return sorted(events, key=lambda event: event.t)


def test_views_entered_at_the_same_instant_are_linked() -> None:
    topology = learned_from(in_step(150, 1))
    camera_of = {zone.id: zone.camera for zone in topology.zones}
    links = [link for link in topology.links if link.relation != "visible"]
    between = {(camera_of[link.from_], camera_of[link.to], link.relation) for link in links}
    assert between == {("a", "b", "overlapped")}


# Lines of one instant come in any order.
@pytest.mark.parametrize("line", [lambda event: event.camera, lambda event: [-ord(event.camera)]])
def test_who_is_in_the_other_view_since_the_same_instant_is_expected_there(line: Line) -> None:
    predictor, told = Predictor(learned_from(in_step(150, 1))), []
    for event in sorted(in_step(60, 2), key=lambda event: (event.t, line(event))):
        if event.kind == "exit" and event.camera == "a":
            told += [
                choice.probability
                for choice in predictor.predict(event).next
                if choice.camera == "b"
            ]
        predictor.observe(event)
    assert np.mean(told) > 0.9


def test_one_who_came_at_the_same_instant_and_has_left_is_not() -> None:
    """It left first, so it is taken as having come first."""
    topology, said = learned_from(in_step(150, 1)), []
    for gone in (2.0, 7.0):
        predictor = Predictor(topology)
        for t, camera, kind in ((0.0, "a", "entry"), (0.0, "b", "entry"), (gone, "b", "exit")):
            if t < 4.0:
                predictor.observe(
                    Event(camera, "exit" if kind == "exit" else "entry", 1e6 + t, track="x")
                )
        next_ = predictor.predict(Event("a", "exit", 1e6 + 4.0, track="x")).next
        said.append(sum(choice.probability for choice in next_ if choice.camera == "b"))
    assert said[0] < 0.3 < 0.9 < said[1]
