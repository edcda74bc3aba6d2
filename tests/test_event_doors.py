"""Whatever takes events or is asked for exits, refuses the same ones with the same sentence."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast
from urllib.parse import urlencode

import pytest
from msgspec.structs import replace
from starlette.requests import Request

from camtopod.client import Gate
from camtopod.codec import Rejected, event_from_msgpack, to_json, to_msgpack
from camtopod.learn.learner import Learner
from camtopod.learn.recording import learn_topology
from camtopod.predict import CityPredictor, CityWalks, Predictor, Walks
from camtopod.records import TOPOLOGY_SCHEMA, Camera, Event, Topology, Zone
from camtopod.serve.bus import QueryError
from camtopod.serve.live_predictions import Live, Reader
from camtopod.topology import UnknownPlace
from camtopod.web.api import Api

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
CITY = replace(SITE, parts=[SITE], owners={"a": SITE.site})
DOORS: dict[str, Callable[[Event], object]] = {
    "Learner.receive": lambda event: Learner().receive(event),
    "learn_topology": lambda event: learn_topology([event]),
    "Predictor.observe": lambda event: Predictor(SITE).observe(event),
    "Predictor.predict": lambda event: Predictor(SITE).predict(event),
    "Walks.observe": lambda event: Walks(SITE).observe(event),
    "CityPredictor.observe": lambda event: CityPredictor(CITY).observe(event),
    "CityPredictor.predict": lambda event: CityPredictor(CITY).predict(event),
    "CityWalks.observe": lambda event: CityWalks(CITY).observe(event),
    "Gate.affinity, exits": lambda event: Gate(SITE).affinity([event], []),
    "Gate.affinity, entries": lambda event: Gate(SITE).affinity([], [event]),
}


OF_EXITS = ("Predictor.predict", "CityPredictor.predict", "Gate.affinity, exits")


def asked_of_daemon(event: Event) -> object:
    """Ask for an exit as a query on the bus does."""
    live = Live(lambda answer: None, lambda: ENTRY.t)
    live.use(Reader(SITE, walks=True))
    fields = {"t": event.t, "x": event.x, "y": event.y}
    parameters = {name: str(value) for name, value in fields.items() if value is not None}
    return live.answer(f"predict/{event.camera}", parameters)


def asked_by_http(event: Event) -> object:
    """Ask for an exit by HTTP."""
    live = Live(lambda answer: None, lambda: ENTRY.t)
    live.use(Reader(SITE, walks=True))

    def query(key: str, parameters: dict[str, str], one: bool) -> list[tuple[str, bytes]]:
        return [(key, to_json(live.answer(key, parameters)))]

    bus = SimpleNamespace(subscribe=lambda key, on_answer: None, query=query)
    feed = SimpleNamespace(topology=SITE, names=lambda: {"a": "a"})
    fields = {"camera": event.camera, "t": event.t, "x": event.x, "y": event.y}
    asked = urlencode({name: value for name, value in fields.items() if value is not None})
    request = Request({"type": "http", "headers": [], "query_string": asked.encode()})
    response = Api(cast(Any, bus), cast(Any, feed), True).predict(request)
    if response.status_code != 200:
        raise QueryError(json.loads(response.body)["error"])
    return response


QUERIES = {"bus": asked_of_daemon, "HTTP": asked_by_http}
"""Ways to ask for an exit by its fields; a kind cannot be wrong there."""


@pytest.mark.parametrize("door", DOORS)
def test_what_is_no_event_is_refused(door: str) -> None:
    with pytest.raises(ValueError, match=r"an enter of a at .*: the kind of an event is entry or"):
        DOORS[door](replace(ENTRY, kind="enter"))
    for t in (math.nan, math.inf, -math.inf):
        with pytest.raises(ValueError, match=r"an entry of a at .*: t is no number of seconds"):
            DOORS[door](replace(ENTRY, t=t))


@pytest.mark.parametrize("door", [*DOORS, *QUERIES])
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
    kind = "entry" if door in DOORS and door not in OF_EXITS else "exit"
    with pytest.raises((Rejected, QueryError)) as of_door:
        (DOORS | QUERIES)[door](replace(ENTRY, **fields, kind=kind))
    assert f": {of_door.value}".endswith(f": {of_line.value}")


@pytest.mark.parametrize("door", [*OF_EXITS, "Gate.affinity, entries", *QUERIES])
def test_a_camera_that_the_version_does_not_have_is_named(door: str) -> None:
    event = replace(ENTRY, camera="b", kind="entry" if door.endswith("entries") else "exit")
    with pytest.raises((UnknownPlace, QueryError)) as of_door:
        (DOORS | QUERIES)[door](event)
    assert str(of_door.value) == "version 1 has no camera 'b'; there are a"


def test_an_entry_is_no_exit() -> None:
    for door in OF_EXITS:
        with pytest.raises(ValueError, match=r"an entry of a at .* among what should be exit eve"):
            DOORS[door](ENTRY)
    with pytest.raises(ValueError, match=r"an exit of a at .* among what should be entry events"):
        DOORS["Gate.affinity, entries"](replace(ENTRY, kind="exit"))
