"""Whatever takes events of a Python program, refuses the same ones with the same sentence."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from msgspec.structs import replace

from camtopod.client import Gate
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


@pytest.mark.parametrize("door", DOORS)
def test_what_is_no_event_is_refused(door: str) -> None:
    with pytest.raises(ValueError, match=r"an enter of a at .*: the kind of an event is entry or"):
        DOORS[door](replace(ENTRY, kind="enter"))
    for t in (math.nan, math.inf, -math.inf):
        with pytest.raises(ValueError, match=r"an entry of a at .*: t is no finite number of s"):
            DOORS[door](replace(ENTRY, t=t))


def test_an_entry_is_no_exit() -> None:
    for door in ("Predictor.predict", "Gate.affinity, exits"):
        with pytest.raises(ValueError, match=r"an entry of a at .* among what should be exit eve"):
            DOORS[door](ENTRY)
    with pytest.raises(ValueError, match=r"an exit of a at .* among what should be entry events"):
        DOORS["Gate.affinity, entries"](replace(ENTRY, kind="exit"))
