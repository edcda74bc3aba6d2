"""Several sites as one: their map, and the data of a camera, from its owner alone."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from pathlib import Path

import pytest
from fake_bus_daemon import NOW
from msgspec.structs import replace
from serving import wait_for
from two_sites import NAMES, OWNERS, TwoSites

from camtopod import codec
from camtopod.records import DaemonStatus, Prediction, Recent, Status
from camtopod.serve.bus import JSON, QueryError, dial
from camtopod.serve.city_bus import CityBus

LEARNED = sorted({*OWNERS} - {"tower", "shed"})
"""Cameras of the map; those have only had one event."""


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TwoSites]:
    both = TwoSites(tmp_path_factory.mktemp("sites"))
    with both.running(*NAMES):
        yield both


@pytest.fixture
def city(sites: TwoSites) -> Iterator[CityBus]:
    with sites.joined() as bus:
        yield bus


def camera_ids(city: CityBus) -> list[str]:
    """Return the cameras of the newest map."""
    return [camera.id for camera in city.topology.cameras] if city.topology is not None else []


def status_of(city: CityBus) -> DaemonStatus:
    """Return the status of all daemons."""
    payload = dict(city.query("status/*"))["status/daemon"]
    return codec.read(DaemonStatus, payload, pack=True)


def test_one_map_has_each_camera_once_and_links_across_the_border(
    sites: TwoSites, city: CityBus
) -> None:
    topology = city.update()

    assert topology is not None
    assert topology.site == "north, south"
    assert [camera.id for camera in topology.cameras] == LEARNED
    assert {pair.cameras for pair in topology.pairs} == {
        ("gate", "hall"),
        ("border", "gate"),
        ("border", "yard"),
        ("border", "ramp"),
    }
    south = sites.daemons["south"].topology
    assert south is not None
    zones = {zone.id: zone for zone in south.zones}
    assert [zone for zone in topology.zones if zone.camera == "border"] == [
        zone for zone in zones.values() if zone.camera == "border"
    ]
    across = {link.to for link in topology.links if link.from_.startswith("gate/")} & zones.keys()
    assert across, "links end in zones as south has learned them"
    codec.require_sound(topology)
    assert city.update() is None, "it is not new"
    versions = [daemon.topology.version for daemon in sites.daemons.values() if daemon.topology]
    assert topology.version == sum(versions)


def test_a_camera_is_what_its_owner_says(sites: TwoSites, city: CityBus) -> None:
    city.update()
    statuses: dict[str, Status] = {}

    def take(key: str, payload: bytes) -> None:
        statuses[key] = codec.read(Status, payload, pack=True)

    city.subscribe("status/*", take)
    wait_for(lambda: "status/daemon" in statuses, "a status of the daemons")
    with contextlib.ExitStack() as stack:
        buses = {site: stack.enter_context(dial(sites.config(site))) for site in NAMES}

        def have_come() -> bool:  # a busy link may drop a status
            for site, bus in buses.items():
                for camera in ("border", "new-one"):
                    reason = f"as {site} hears"
                    status = {"camera": camera, "state": "stalled", "reason": reason, "t": NOW}
                    bus.publish(f"status/{camera}", status, "status")
            return {"status/border", "status/new-one"} <= statuses.keys()

        wait_for(have_come, "the statuses", interval=0.2)
    assert statuses["status/border"].reason == "as south hears"


def test_the_daemons_have_one_status_with_each_camera_once(sites: TwoSites, city: CityBus) -> None:
    status = status_of(city)

    assert status.state == "running"
    assert set(status.cameras) == set(OWNERS)
    daemons = {site: daemon.status() for site, daemon in sites.daemons.items()}
    assert status.cameras["border"] == daemons["south"].cameras["border"]
    assert status.cameras["border"] != daemons["north"].cameras["border"]
    assert status.events.stored == sum(one.events.stored for one in daemons.values())


def test_predictions_are_the_owners(sites: TwoSites, city: CityBus) -> None:
    city.update()
    received: list[Prediction] = []
    city.subscribe(
        "prediction/*",
        lambda _, payload: received.append(codec.read(Prediction, payload, pack=True)),
    )
    attempts = iter(range(100))

    def told() -> bool:
        number = next(attempts)  # until the sessions have subscribed
        sites.leave("border", f"p{number}", "north", "south")
        sites.leave("gate", f"p{number}", "north")
        return {"border", "gate"} <= {prediction.camera for prediction in received}

    wait_for(told, "predictions of both sites", interval=0.2)
    expected = {
        prediction.camera: {one.camera for one in prediction.next} for prediction in received
    }
    assert expected["border"] & {"yard", "ramp"}, "north knows of neither"
    assert expected["gate"] & {"hall", "border"}
    [(_, answer)] = city.query("predict/border", {"x": 0.9, "y": 0.5, "t": NOW})
    assert codec.read(Prediction, answer, pack=True).next[0].camera in ("yard", "ramp")


def test_events_are_told_once(sites: TwoSites, city: CityBus) -> None:
    city.update()
    sites.leave("border", "recent", "north", "south")
    sites.leave("hall", "recent", "north")

    def recent(**parameters: object) -> Recent:
        [(_, payload)] = city.query("recent", parameters)
        return codec.read(Recent, payload, pack="format" not in parameters)

    wait_for(lambda: "hall" in {event.camera for event in recent().events}, "the events")
    now = [event for event in recent().events if event.t == NOW]
    counts = {one: sum(event.camera == one for event in now) for one in ("border", "hall")}
    south = sites.daemons["south"]
    assert counts["hall"] == 1
    assert counts["border"] >= 1
    walked = sum(event.camera == "border" for event in sites.events("south"))
    assert counts["border"] == south.status().cameras["border"].events - walked, "not as of both"
    hours = recent(since=math.inf, hours=1, format=JSON).hours
    assert hours is not None
    assert {"border", "hall"} <= set(hours.cameras)


def test_older_maps_are_not_kept(city: CityBus) -> None:
    with pytest.raises(QueryError, match="older maps"):
        city.query("topology", {"epoch": "x", "version": 1})


def test_a_site_that_is_away_is_named_and_the_other_goes_on(tmp_path: Path) -> None:
    sites = TwoSites(tmp_path)
    with sites.running("north"), sites.joined() as city:
        topology = city.update()
        assert topology is not None
        assert {camera.id for camera in topology.cameras} == {"gate", "hall"}
        assert city.owner("border") == "south", "as the districts say, which is not there yet"
        wait_for(
            lambda: status_of(city).state == "running, south cannot be reached", "that it is away"
        )

        with sites.running("south"):
            wait_for(lambda: status_of(city).state == "running", "both")
            wait_for(lambda: bool(city.update()) and camera_ids(city) == LEARNED, "its map")
        wait_for(
            lambda: status_of(city).state == "running, south cannot be reached", "that it has gone"
        )
        assert city.connected


def test_what_is_not_on_the_map_is_counted(
    sites: TwoSites,
    city: CityBus,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    south = sites.daemons["south"].topology
    assert south is not None
    elsewhere = [
        replace(zone, x=1.0 - zone.x, y=0.01) if zone.camera == "border" and zone.x else zone
        for zone in south.zones
    ]
    monkeypatch.setattr(city._sites["south"], "topology", replace(south, zones=elsewhere))

    with caplog.at_level("INFO"):
        topology = city.update()

    assert topology is not None
    assert ("border", "gate") not in {pair.cameras for pair in topology.pairs}
    assert "2 zones match none of their camera's owner" in caplog.text
