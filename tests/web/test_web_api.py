"""The HTTP API, with a real daemon on a real bus, by its own description."""

from __future__ import annotations

import contextlib
import json
import urllib.error
import urllib.request
from collections.abc import Iterator
from typing import Any

import jsonschema
import pytest
from fake_bus_daemon import LEFT, Hub, a_hub, later, put, there
from openapi_spec_validator import OpenAPIV31SpecValidator
from serving import numbered, wait_for, walkers

from camtopod.cli.commands.web import listening, names
from camtopod.cli.generated.api_description import api_description
from camtopod.client import Topology
from camtopod.codec import to_json
from camtopod.config.settings import BusSettings, Config
from camtopod.serve.bus import dial
from camtopod.web import app

DESCRIPTION = api_description()
HOST = "127.0.0.1"


@pytest.fixture(scope="module")
def hub(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hub]:
    with a_hub(tmp_path_factory.mktemp("hub")) as one:
        yield one


@contextlib.contextmanager
def served(hub: Hub, any_address: bool = False) -> Iterator[str]:
    """Serve the page of the hub's site; yield the address of its API."""
    config = Config(bus=BusSettings(connect=(hub.daemon.endpoint,)))
    with (
        dial(config) as bus,
        listening(HOST, 0) as listener,
        app.serving(bus, listener, names(HOST), None, lambda: 1000.0, 1.0, any_address),
    ):
        address = f"http://{HOST}:{listener.getsockname()[1]}/api"
        wait_for(lambda: get(address + "/topology")[0] != 404, "the topology")
        yield address


@pytest.fixture(scope="module")
def api(hub: Hub) -> Iterator[str]:
    with served(hub) as address:
        yield address


def get(url: str) -> tuple[int, Any]:
    try:
        with urllib.request.urlopen(url, timeout=20) as answer:
            return answer.status, json.loads(answer.read())
    except urllib.error.HTTPError as error:
        with error:
            return error.code, json.loads(error.read())


def checked(api: str, path: str, status: int = 200) -> Any:
    """Return an answer, after checking its status and that it is as described."""
    got, content = get(api + path)
    assert got == status, content
    described = DESCRIPTION["paths"]["/api" + path.partition("?")[0]]["get"]["responses"]
    schema = described[str(status)]["content"]["application/json"]["schema"]
    jsonschema.validate(content, {**schema, "components": DESCRIPTION["components"]})
    return content


def test_the_description_is_openapi_and_is_served(api: str) -> None:
    OpenAPIV31SpecValidator(DESCRIPTION).validate()
    spoiled = {**DESCRIPTION, "paths": {"/api/topology": {"get": {"responses": {}, "sumary": 1}}}}
    assert list(OpenAPIV31SpecValidator(spoiled).iter_errors())
    assert get(api + "/openapi.json") == (200, DESCRIPTION)


def test_the_topology_and_its_versions(api: str, hub: Hub) -> None:
    assert hub.daemon.topology is not None
    newest = json.loads(to_json(hub.daemon.topology))
    assert checked(api, "/topology") == newest
    assert checked(api, f"/topology?version={newest['version']}") == newest
    assert checked(api, "/versions")[-1]["version"] == newest["version"]
    assert "not kept" in checked(api, "/topology?version=9999", 404)["error"]
    assert "'new' is not a whole number" in checked(api, "/topology?version=new", 400)["error"]


def test_a_prediction_is_the_daemon_s(api: str, hub: Hub) -> None:
    query = "&".join(f"{name}={value}" for name, value in LEFT.items())
    with Topology.connect(connect=hub.daemon.endpoint) as site:
        expected = json.loads(to_json(site.predict(**LEFT)))
    got = checked(api, f"/predict?{query}")
    assert {one["camera"] for one in got["next"][:2]} == {"b", "c"}
    assert got.keys() == expected.keys()
    assert got["leave"] == pytest.approx(expected["leave"], abs=0.05)


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ("", "the id of the camera"),
        ("?camera=a/b", "the id of the camera"),
        ("?camera=a&place=3", "unknown parameter 'place': use zone, x, y, t, now"),
        ("?camera=a&zone=b/1", "camera 'a' has no zone 'b/1'"),
        ("?camera=a&zone=a/1%3Bt=5", "zone is an id of the topology"),
        ("?camera=a&t=noon", "t, x, y and now are numbers"),
    ],
)
def test_a_wrong_question_is_answered_with_what_is_wrong(api: str, query: str, said: str) -> None:
    assert said in checked(api, f"/predict{query}", 400)["error"]


def test_the_status(api: str) -> None:
    wait_for(lambda: "site" in checked(api, "/status")["daemon"], "the daemon's status")
    status = checked(api, "/status")
    assert status["daemon"]["site"] == "site"
    assert {"a", "b", "c"} <= {one["id"] for one in status["cameras"]}


def test_predictions_are_streamed(api: str, hub: Hub) -> None:
    events = later(numbered(walkers(40, seed=7), boot="stream"), 12)
    exits = [event for event in events if event.kind == "exit" and event.camera == "a"]
    with (
        urllib.request.urlopen(api + "/predictions?camera=a", timeout=30) as stream,
        Topology.connect(connect=hub.daemon.endpoint) as site,
    ):
        assert stream.headers["content-type"].startswith("text/event-stream")
        there(site)
        config = Config(bus=BusSettings(connect=(hub.daemon.endpoint,)))
        with dial(config) as bus:
            put(bus, *events)
            lines = (line.decode().rstrip("\n") for line in stream)
            data = (line.removeprefix("data: ") for line in lines if line.startswith("data: "))
            got = [json.loads(next(data)) for _ in range(5)]
    assert {one["camera"] for one in got} == {"a"}
    assert {one["t"] for one in got} <= {event.t for event in exits}
    assert "the id of a camera" in checked(api, "/predictions?camera=a/b", 400)["error"]


def test_without_a_password_other_machines_are_refused(hub: Hub) -> None:
    with served(hub, any_address=True) as address:
        for path in ("/topology", "/versions", "/status", "/predict?camera=a", "/predictions"):
            said = checked(address, path, 403)["error"]
            assert "on its own machine only" in said
