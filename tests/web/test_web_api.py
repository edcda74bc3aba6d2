"""The HTTP API, with a real daemon on a real bus."""

from __future__ import annotations

import contextlib
import itertools
import json
import urllib.error
import urllib.request
from collections.abc import Iterator
from typing import Any
from urllib.parse import quote

import pytest
from fake_bus_daemon import LEFT, LearnedDaemon, later, put, running_learned_daemon, there
from serving import numbered, wait_for, walkers

from camtopod.cli.commands.web import listening, names
from camtopod.client import Site
from camtopod.codec import to_json
from camtopod.config.settings import BusSettings, Config
from camtopod.records import Match, MatchedPassage
from camtopod.serve.bus import dial
from camtopod.web import app

HOST = "127.0.0.1"


@pytest.fixture(scope="module")
def learned_daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LearnedDaemon]:
    with running_learned_daemon(tmp_path_factory.mktemp("site")) as one:
        yield one


@contextlib.contextmanager
def served(learned_daemon: LearnedDaemon, any_address: bool = False) -> Iterator[str]:
    """Serve the page of the learned_daemon's site; yield the address of its API."""
    config = Config(bus=BusSettings(connect=(learned_daemon.daemon.endpoint,)))
    with (
        dial(config) as bus,
        listening(HOST, 0) as listener,
        app.serving(bus, listener, names(HOST), lambda: 1000.0, config, any_address),
    ):
        address = f"http://{HOST}:{listener.getsockname()[1]}/api"
        wait_for(lambda: answer(address + "/topology")[0] != 404, "the topology")
        yield address


@pytest.fixture(scope="module")
def api(learned_daemon: LearnedDaemon) -> Iterator[str]:
    with served(learned_daemon) as address:
        yield address


def answer(url: str) -> tuple[int, Any]:
    """Return status and content of an answer."""
    try:
        with urllib.request.urlopen(url, timeout=20) as response:
            return response.status, json.loads(response.read())
    except urllib.error.HTTPError as error:
        with error:
            return error.code, json.loads(error.read())


def content(url: str) -> Any:
    """Return the content of an answer to a right question."""
    status, found = answer(url)
    assert status == 200, found
    return found


def test_the_topology_and_its_versions(api: str, learned_daemon: LearnedDaemon) -> None:
    assert learned_daemon.daemon.topology is not None
    number = learned_daemon.daemon.topology.version
    newest = content(f"{api}/topology")

    assert newest["version"] == number
    assert newest["model"]["departures"]
    assert content(f"{api}/topology?version={number}") == newest
    assert content(f"{api}/versions")[-1]["version"] == number
    for wrong, status, said in (
        ("9999", 404, "is not kept"),
        ("new", 404, "version new of epoch"),
        ("1;epoch=2", 400, "an id of the topology or a number"),
    ):
        got, error = answer(f"{api}/topology?version={quote(wrong)}")
        assert (got, said in error["error"]) == (status, True), error


def test_a_prediction_is_the_daemon_s(api: str, learned_daemon: LearnedDaemon) -> None:
    query = "&".join(f"{name}={value}" for name, value in LEFT.items())
    with Site.connect(connect=learned_daemon.daemon.endpoint) as site:
        expected = json.loads(to_json(site.predict(**LEFT)))

    got = content(f"{api}/predict?{query}")

    assert {one["camera"] for one in got["next"][:2]} == {"b", "c"}
    assert got.keys() == expected.keys()
    assert got["leave"] == pytest.approx(expected["leave"], abs=0.05)


def test_a_wrong_question_is_answered_with_what_is_wrong(api: str) -> None:
    for query, said in (
        ("predict", "Expected a camera id"),
        ("predict?camera=a&place=3", "unknown parameter 'place': use zone, x, y, t, now, label"),
        ("predict?camera=a&zone=b/1", "has no zone of a called 'b/1'; there are a/"),
        ("predict?camera=a&zone=a/1%3Bt=5", "an id of the topology or a number"),
        ("predict?camera=a&t=noon", "t, x, y and now are numbers"),
        ("predictions?camera=a/b", "the id of a camera"),
        ("matches?camera=a/b", "the id of a camera"),
        ("walks?since=noon", "Unix seconds"),
    ):
        status, error = answer(f"{api}/{query}")
        assert (status, said in error["error"]) == (400, True), error


def test_a_camera_that_is_not_there_is_answered_with_those_that_are(api: str) -> None:
    status, error = answer(f"{api}/predict?camera=nowhere")
    assert status == 404
    assert "has no camera 'nowhere'; there are" in error["error"]


def test_the_status(api: str) -> None:
    wait_for(lambda: "site" in content(f"{api}/status")["daemon"], "the daemon's status")
    status = content(f"{api}/status")
    assert status["daemon"]["site"] == "site"
    assert {"a", "b", "c"} <= {one["id"] for one in status["cameras"]}


def test_predictions_are_streamed(api: str, learned_daemon: LearnedDaemon) -> None:
    events = later(numbered(walkers(40, seed=7), boot="stream"), 12)
    exits = {event.t for event in events if event.kind == "exit" and event.camera == "a"}
    with (
        urllib.request.urlopen(api + "/predictions?camera=a", timeout=30) as stream,
        Site.connect(connect=learned_daemon.daemon.endpoint) as site,
    ):
        there(site)
        put(learned_daemon.bus, *events)
        lines = (line.decode().rstrip("\n") for line in stream)
        lines = itertools.takewhile(lambda line: not line.startswith("event:"), lines)
        data = (line.removeprefix("data: ") for line in lines if line.startswith("data: "))
        got = [json.loads(next(data)) for _ in range(5)]

    assert stream.headers["content-type"].startswith("text/event-stream")
    assert {one["camera"] for one in got} == {"a"}
    assert {one["t"] for one in got} <= exits


def test_matches_are_streamed_and_kept(api: str, learned_daemon: LearnedDaemon) -> None:
    passage = MatchedPassage("b", 985.0, 0.9, "7")
    matches = [Match(camera, 990.0, 1, [passage], 0.1, "b@985", "3") for camera in ("c", "a")]
    with urllib.request.urlopen(api + "/matches?camera=a", timeout=30) as stream:
        for one in matches:
            learned_daemon.bus.publish(f"match/{one.camera}", one, "match")
        lines = (line.decode().rstrip("\n") for line in stream)
        got = json.loads(next(line for line in lines if line.startswith("data: "))[6:])

    assert got == json.loads(to_json(matches[1]))
    wait_for(lambda: len(content(f"{api}/walks?since=989")) == 2, "both matches")
    assert got in content(f"{api}/walks")
    assert content(f"{api}/walks?since=990") == []
    shown = content(api.removesuffix("/api") + "/data/walks")
    assert [one["camera"] for one in shown] == ["c", "a"]
    assert "track" not in {*shown[0], *shown[0]["from"][0]}


def test_without_a_password_other_machines_are_refused(learned_daemon: LearnedDaemon) -> None:
    with served(learned_daemon, any_address=True) as address:
        for path in (
            "/topology",
            "/versions",
            "/status",
            "/predict?camera=a",
            "/predictions",
            "/matches",
            "/walks",
        ):
            status, error = answer(address + path)
            assert (status, "on its own machine only" in error["error"]) == (403, True), path
