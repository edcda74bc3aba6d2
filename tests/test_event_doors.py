"""Whatever takes events of a Python program, refuses the same ones with the same sentence."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from msgspec.structs import replace

from camtopod.client import Gate
from camtopod.codec import Rejected, event_from_msgpack, to_msgpack
from camtopod.learn.learner import Learner
from camtopod.learn.recording import learn_topology
from camtopod.predict import Predictor, Walks
from camtopod.records import TOPOLOGY_SCHEMA, Camera, Event, Topology, Zone

ENTRY = Event("a", "entry", 1_700_000_000.0)
SITE = Topology(
    TOPOLOGY_SCHEMA,
    "hq",
    "01J",
    1,
    ENTRY.t,
    10,
    "",
    [Camera("a", ["a/1"])],
    [Zone("a/1", "a", 5, 5)],
    [],
    [],
)
DOORS: dict[str, Callable[[Event], object]] = {
    "Learner.receive": lambda event: Learner().receive(event),
    "learn_topology": lambda event: learn_topology([event]),
    "Predictor.observe": lambda event: Predictor(SITE).observe(event),
    "Predictor.predict": lambda event: Predictor(SITE).predict(event),
    "Walks.observe": lambda event: Walks(SITE).observe(event),
    "Gate.affinity, exits": lambda event: Gate(SITE).affinity([event], []),
    "Gate.affinity, entries": lambda event: Gate(SITE).affinity([], [event]),
}


OF_EXITS = ("Predictor.predict", "Gate.affinity, exits")


@pytest.mark.parametrize("door", DOORS)
def test_what_is_no_event_is_refused(door: str) -> None:
    with pytest.raises(ValueError, match=r"an enter of a at .*: the kind of an event is entry or"):
        DOORS[door](replace(ENTRY, kind="enter"))
    for t in (math.nan, math.inf, -math.inf):
        with pytest.raises(ValueError, match=r"an entry of a at .*: t is no number of seconds"):
            DOORS[door](replace(ENTRY, t=t))


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize(
    "fields",
    [
        {"camera": "front door"},
        {"camera": "daemon"},
        {"camera": ""},
        {"t": 1_700_000_000_000.0},
        {"x": 5.0, "y": 0.5},
        {"x": 0.5, "y": -0.1},
        {"x": math.nan, "y": 0.5},
        {"x": 0.5},
        {"y": 0.5},
    ],
)
def test_what_no_event_line_may_say_is_refused_in_the_same_words(
    door: str, fields: dict[str, Any]
) -> None:
    line = {"camera": "a", "kind": "entry", "t": ENTRY.t, **fields}
    with pytest.raises(Rejected) as of_line:
        event_from_msgpack(to_msgpack(line))
    with pytest.raises(Rejected) as of_door:
        DOORS[door](replace(ENTRY, **fields, kind="exit" if door in OF_EXITS else "entry"))
    assert str(of_door.value).endswith(f": {of_line.value}")


def test_an_entry_is_no_exit() -> None:
    for door in OF_EXITS:
        with pytest.raises(ValueError, match=r"an entry of a at .* among what should be exit eve"):
            DOORS[door](ENTRY)
    with pytest.raises(ValueError, match=r"an exit of a at .* among what should be entry events"):
        DOORS["Gate.affinity, entries"](replace(ENTRY, kind="exit"))
