"""Home Assistant discovery: everything announced is published, by a real bridge and broker."""

from __future__ import annotations

import contextlib
import json
import re
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest
from fake_bus import OneBus
from mosquitto import PROGRAM, Broker, mosquitto
from serving import T0, all_out, camtopod, closing_event, numbered, small_config, wait_for, walkers

from camtopod.cli import exits
from camtopod.cli.commands.bridge import HomeAssistantState
from camtopod.cli.main import main
from camtopod.export import homeassistant
from camtopod.export.arrivals import Awaited, ExpectedArrivals, Passing
from camtopod.export.homeassistant import Topics
from camtopod.records import (
    TOPOLOGY_SCHEMA,
    Alarm,
    Between,
    BetweenPair,
    Camera,
    CameraFigures,
    DaemonStatus,
    Look,
    Match,
    MatchedPassage,
    NamesStatus,
    NextCamera,
    Prediction,
    SelfScore,
    Status,
    Topology,
)
from camtopod.serve import bus as buses
from camtopod.serve.bus import Bus
from camtopod.serve.daemon import Daemon
from camtopod.words import CameraState, camera_states, daemon_state

TOPICS = Topics("hq")
SCORE = SelfScore(200, 3, 1.25, 0.814, 0.93, 1.75, 0.55)
ALARM = Alarm(8, T0, "link_closed", "lobby/1->hall/2", "share 0.60 until 5, 0.00 since")
TOPOLOGY = Topology(
    TOPOLOGY_SCHEMA, "hq", "01J", 9, T0, 0, "sha256:0", [], [], [], [], alarms=[ALARM], score=SCORE
)
needs_broker = pytest.mark.skipif(
    PROGRAM is None, reason="needs the broker mosquitto (Debian: mosquitto)"
)


def decoded(messages: dict[str, str]) -> dict[str, Any]:
    return {
        topic: json.loads(text) if text.startswith("{") else text
        for topic, text in messages.items()
    }


def of_camera(name: str, figures: CameraFigures, status: Status | None) -> CameraState:
    daemon = DaemonStatus("running", cameras={name: figures})
    [state] = camera_states(daemon, {name: (status, 0.0)} if status else {}, None, {})
    return state


def to_hall(leave: float, *shares: tuple[str, float]) -> Prediction:
    nexts = [NextCamera(camera, f"{camera}/1", share, 5.0, 7.0, 9.0) for camera, share in shares]
    return Prediction("lobby", "lobby/1", T0, "17", 9, leave, nexts)


def arrival(camera: str, *passages: MatchedPassage) -> Passing:
    new = 1.0 - sum(one.probability for one in passages)
    match = Match(camera, T0, 9, list(passages), new, f"{camera}@1", "17")
    return ExpectedArrivals().entered(match)


# --- what is published ----------------------------------------------------------------------------


BETWEEN = Between(T0, T0 - 60.0, 3.26, 2, 5, [BetweenPair("lobby", "hall", 3.26, 2, 5)])


def test_objects_between_cameras_are_unknown_while_nobody_counts() -> None:
    def told(alive: bool, status: DaemonStatus) -> Any:
        state = daemon_state(status, 0.0, away="" if alive else "it is away")
        states = homeassistant.site_state(TOPICS, state, status, TOPOLOGY)
        return decoded(states)["camtopod/hq/daemon/between"]

    counted = told(True, DaemonStatus("running", between=BETWEEN))
    assert counted == {
        "between": 3.3,
        "low": 2,
        "high": 5,
        "since": "2023-11-14T22:12:20+00:00",
        "pairs": [{"from": "lobby", "to": "hall", "number": 3.26, "low": 2, "high": 5}],
    }
    assert set(told(True, DaemonStatus("running")).values()) == {None}
    assert set(told(False, DaemonStatus("running", between=BETWEEN)).values()) == {None}


def test_every_entity_finds_its_figure() -> None:
    """Its topic is published and has the field that its template takes."""
    cameras = ["lobby", "north.gate", "a_b", "a.b"]
    announced = decoded(homeassistant.discovery(TOPICS, cameras))
    status = DaemonStatus("running", between=BETWEEN)
    states = homeassistant.site_state(TOPICS, daemon_state(status, 0.0), status, TOPOLOGY)
    for camera in cameras:
        states |= homeassistant.camera_state(TOPICS, of_camera(camera, CameraFigures(), None), 3)
        states |= homeassistant.prediction_state(
            TOPICS, msgspec.structs.replace(to_hall(1.0), camera=camera)
        )
        states |= homeassistant.arrival_states(TOPICS, camera, {}, {})
        states |= homeassistant.walk_messages(TOPICS, arrival(camera))
    published = decoded(states)
    assert len(announced) == len({config["unique_id"] for config in announced.values()})
    assert len(announced) == len(homeassistant.SITE_ENTITIES) + 4 * len(
        homeassistant.CAMERA_ENTITIES
    )
    for topic, config in announced.items():
        assert re.fullmatch(
            r"homeassistant/(sensor|binary_sensor|event)/[A-Za-z0-9_-]+/[A-Za-z0-9_-]+/config",
            topic,
        )
        state = published[config["state_topic"]]
        if "/event/" in topic:
            assert state["event_type"] in config["event_types"]
            continue
        [field] = re.findall(r"^\{\{ value_json\.(\w+) \}\}$", config["value_template"])
        if "binary_sensor" in topic:
            assert state[field] in ("ON", "OFF")
        else:
            assert isinstance(state[field], str | int | float)
            assert len(str(state[field])) <= 255
        for available in config["availability"]:
            assert available["topic"] == TOPICS.bridge or published[available["topic"]] == "online"
    devices = {
        tuple(config["device"]["identifiers"]): config["device"] for config in announced.values()
    }
    assert {device.get("via_device") for device in devices.values()} == {None, "camtopod/hq"}
    assert len(devices) == 5
    assert {device["name"] for device in devices.values()} == {
        *("hq camtopod", "hq lobby", "hq north.gate", "hq a_b", "hq a.b")
    }


def test_the_states() -> None:
    full, well = DaemonStatus("degraded", "disk full"), DaemonStatus("running")
    away = daemon_state(well, 0.0, away="the daemon is not running")
    bad = decoded(homeassistant.site_state(TOPICS, daemon_state(full, 0.0), full, TOPOLOGY))
    gone = decoded(homeassistant.site_state(TOPICS, away, well, None))

    state, alarm = bad["camtopod/hq/daemon/state"], bad["camtopod/hq/daemon/alarm"]
    assert (state["problem"], state["reason"]) == ("ON", "disk full")
    assert (state["version"], state["score"]) == (9, 81.4)
    assert alarm["alarm"] == "link closed lobby/1 → hall/2"
    assert alarm["at"] == "2023-11-14T22:13:20+00:00"
    assert gone["camtopod/hq/daemon/state"]["problem"] == "ON"
    assert gone["camtopod/hq/daemon/state"]["version"] is None
    assert gone["camtopod/hq/daemon/availability"] == "offline"
    assert gone["camtopod/hq/daemon/alarm"] == {"alarm": "none"}


@pytest.mark.parametrize(
    ("alive", "said", "online"),
    [
        (True, Status("running"), "ON"),
        (True, None, "ON"),  # another program's camera, which says nothing
        (True, Status("stalled", "no frame"), "OFF"),
        (False, Status("running"), "OFF"),  # what it said before it was killed
    ],
)
def test_when_a_camera_is_online(alive: bool, said: Status | None, online: str) -> None:
    [state] = decoded(
        homeassistant.camera_state(
            TOPICS, of_camera("lobby", CameraFigures(5, alive=alive), said), 2
        )
    ).values()
    assert (state["online"], state["events"], state["zones"]) == (online, 5, 2)


def shown(prediction: Prediction) -> dict[str, Any]:
    """Return what Home Assistant is told of a prediction."""
    [state] = decoded(homeassistant.prediction_state(TOPICS, prediction)).values()
    return dict(state)


def test_the_next_camera_is_that_of_all_its_zones_together() -> None:
    hall = shown(to_hall(0.3, ("yard", 0.25), ("hall", 0.2), ("hall", 0.25)))
    leaves = shown(to_hall(0.6, ("hall", 0.4)))

    assert (hall["next"], hall["probability"]) == ("hall", 0.45)
    assert hall["from"] == "2023-11-14T22:13:25+00:00"
    assert hall["until"] == "2023-11-14T22:13:29+00:00"
    assert (leaves["next"], leaves["until"]) == ("leaves", None)


def test_a_camera_is_not_its_own_next_one_and_nobody_comes_before_leaving() -> None:
    """Where views overlap, objects are seen before they leave."""
    back = shown(to_hall(0.1, ("lobby", 0.9)))
    over = msgspec.structs.replace(
        to_hall(0.1), next=[NextCamera("hall", "hall/1", 0.9, -18.0, -17.0, -16.0)]
    )

    assert back["next"] == "returns"
    assert shown(over)["from"] == shown(over)["until"] == shown(over)["left"]


def test_whether_somebody_is_about_to_come() -> None:
    hall = {"hall": Awaited(0.75, "lobby", T0 + 5, T0 + 9)}
    yard = {"yard": Awaited(0.5, "lobby", T0 + 5, T0 + 9)}

    told = decoded(homeassistant.arrival_states(TOPICS, "hall", hall, yard))
    maybe = decoded(homeassistant.arrival_states(TOPICS, "yard", yard, {}))

    assert told == {
        "camtopod/hq/camera/hall/expected": {
            "expected": "ON",
            "probability": 0.75,
            "camera": "lobby",
            "from": "2023-11-14T22:13:25+00:00",
            "until": "2023-11-14T22:13:29+00:00",
        },
        "camtopod/hq/camera/hall/look_here": {
            **{"look_here": "OFF", "probability": 0.0},
            **{"camera": None, "from": None, "until": None},
        },
    }
    assert maybe["camtopod/hq/camera/yard/expected"]["expected"] == "OFF"


def test_each_entry_is_told_with_its_walk_and_a_second_match_is_no_second_arrival() -> None:
    passing = arrival("hall", MatchedPassage("lobby", T0 - 9, 0.93, "31"))
    told = decoded(homeassistant.walk_messages(TOPICS, passing))
    again = homeassistant.walk_messages(
        TOPICS, msgspec.structs.replace(passing, again=True, was="b@2")
    )

    walk, event = told["camtopod/hq/walk"], told["camtopod/hq/camera/hall/arrival"]
    assert walk == {
        **msgspec.to_builtins(passing.match),
        "passages": [{"camera": "hall", "t": T0, "track": "17"}],
    }
    assert walk["from"][0] == {"camera": "lobby", "t": T0 - 9, "probability": 0.93, "track": "31"}
    assert event == {
        "event_type": "continued",
        "walk": "hall@1",
        "probability": 0.93,
        "camera": "lobby",
        "track": "17",
        "entered": "2023-11-14T22:13:20+00:00",
    }
    assert decoded(again) == {"camtopod/hq/walk": walk | {"was": "b@2", "again": True}}


def test_an_arrival_is_new_or_continued_only_where_that_is_probable() -> None:
    half = [MatchedPassage("lobby", T0 - 9, 0.45), MatchedPassage("yard", T0 - 9, 0.47)]
    for passages, kind, probability, camera in (
        ([], "new", 1.0, None),
        (half[:1], "new", 0.55, None),
        (half, "uncertain", 0.47, "yard"),
        ([MatchedPassage("yard", T0 - 9, 0.51)], "continued", 0.51, "yard"),
    ):
        told = decoded(homeassistant.walk_messages(TOPICS, arrival("hall", *passages)))
        event = told["camtopod/hq/camera/hall/arrival"]
        assert event["event_type"] == kind
        assert (event["probability"], event["camera"]) == (probability, camera)


def test_the_camera_to_look_at_is_the_likeliest_other_one() -> None:
    next_ = to_hall(0.1, ("lobby", 0.4), ("hall", 0.2), ("yard", 0.25), ("hall", 0.05))
    seen = msgspec.structs.replace(next_, look=[Look("yard", 0.9), Look("hall", 0.1)])

    for prediction, look, sees in (
        (next_, "hall", 0.25),
        (seen, "yard", 0.9),
        (to_hall(1.0), "none", 0.0),
    ):
        assert (shown(prediction)["look"], shown(prediction)["sees"]) == (look, sees)


def test_a_camera_is_neither_on_nor_off_until_it_is_known() -> None:
    """After a start of the daemon its status has cameras as they come."""
    bus = OneBus()
    bus.kept = {9: msgspec.structs.replace(TOPOLOGY, cameras=[Camera("lobby", [])])}
    site = HomeAssistantState(cast(Bus, bus), TOPICS, 10)

    def online(camera: str) -> str | None:
        told = decoded(site.messages(T0))
        assert f"camtopod_hq/{camera}-online" in "".join(told), "it is announced all the same"
        return told.get(TOPICS.topic_of(camera, "state"), {}).get("online")

    bus.publish("status/daemon", DaemonStatus("running"))
    assert online("lobby") is None
    bus.publish("status/lobby", Status("running"))
    assert online("lobby") == "ON"
    bus.publish("status/daemon", DaemonStatus("running", cameras={"lobby": CameraFigures()}))
    assert online("lobby") == "OFF"
    bus.publish("status/yard", Status("stalled"))
    assert online("yard") == "OFF"


def test_who_comes_is_known_from_predictions_and_matches() -> None:
    bus = OneBus()
    site = HomeAssistantState(cast(Bus, bus), TOPICS, 10)
    bus.publish("status/daemon", DaemonStatus("running", cameras={"hall": CameraFigures()}))
    assert TOPICS.topic_of("hall", "expected") not in site.messages(T0), "nothing is learned yet"

    bus = OneBus()
    bus.kept = {9: msgspec.structs.replace(TOPOLOGY, cameras=[Camera("hall", [])])}
    site = HomeAssistantState(cast(Bus, bus), TOPICS, 10)

    def of(topic: str, now: float) -> Any:
        return decoded(site.messages(now))[TOPICS.topic_of("hall", topic)][topic]

    bus.publish("prediction/lobby", to_hall(0.2, ("hall", 0.8)))
    assert site.events(T0) == []
    assert (of("expected", T0), of("look_here", T0)) == ("ON", "ON")

    match = Match("hall", T0 + 6, 9, [MatchedPassage("lobby", T0, 0.9, "17")], 0.1, "lobby@1")
    bus.publish("match/hall", match)
    bus.publish("match/a b", msgspec.structs.replace(match, camera="a b"))
    [told] = site.events(T0 + 6)
    assert told.keys() == {TOPICS.walk, TOPICS.topic_of("hall", "arrival")}
    assert (of("expected", T0 + 6), of("look_here", T0 + 6)) == ("OFF", "ON")
    assert of("look_here", T0 + 17) == "OFF"
    assert site.events(T0 + 17) == []

    # A camera is forgotten: its passages are in no walk, and nobody comes from there.
    bus.publish("match/lobby", Match("lobby", T0 + 18, 9, [], 1.0, "yard@1"))
    bus.publish("prediction/lobby", to_hall(0.2, ("hall", 0.8)))
    site.events(T0 + 18)
    names = NamesStatus(forgotten={"lobby": 0})
    bus.publish("status/daemon", DaemonStatus("running", names=names))
    bus.publish("match/hall", msgspec.structs.replace(match, t=T0 + 20, from_=[], walk="yard@1"))
    [messages] = site.events(T0 + 20)
    passages = decoded(messages)[TOPICS.walk]["passages"]
    assert [passage["camera"] for passage in passages] == ["hall"]
    bus.publish("status/hall", Status("running"))
    assert (of("expected", T0 + 3), of("look_here", T0 + 3)) == ("OFF", "OFF")


# --- with a broker --------------------------------------------------------------------------------


class HomeAssistant:
    """A subscriber to everything that stores the newest message of each topic."""

    def __init__(self, broker: Broker) -> None:
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion

        self.heard: dict[str, str] = {}
        self._client = client = Client(CallbackAPIVersion.VERSION2)
        client.on_connect = lambda *_: client.subscribe("#", qos=1)
        client.on_message = lambda _, __, message: self.heard.update(
            {message.topic: message.payload.decode()}
        )
        client.reconnect_delay_set(1, 1)
        client.connect("127.0.0.1", broker.port)
        client.loop_start()

    def of(self, topic: str, field: str) -> Any:
        return json.loads(self.heard.get(f"camtopod/site/{topic}", "{}")).get(field)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


class Bridge:
    def __init__(self, folder: Path, broker: Broker, endpoint: str) -> None:
        self._err = folder / "err.txt"
        url = f"mqtt://127.0.0.1:{broker.port}"
        with self._err.open("wb") as err:
            self.process = camtopod("--connect", endpoint, "bridge", url, stderr=err)
        wait_for(
            lambda: "publishing below camtopod" in self.said or self.process.poll() is not None,
            "the bridge",
        )
        assert self.process.poll() is None, self.said

    @property
    def said(self) -> str:
        return self._err.read_text()

    def end(self, number: int) -> int:
        self.process.send_signal(number)
        return self.process.wait(20)


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    pytest.importorskip("paho.mqtt.client", reason="needs paho-mqtt (camtopod[mqtt])")
    with mosquitto(tmp_path) as one:
        yield one


@pytest.fixture
def bridged(broker: Broker, tmp_path: Path) -> Iterator[tuple[Daemon, Bridge]]:
    with Daemon(small_config(tmp_path / "state")) as daemon:
        bridge = Bridge(tmp_path, broker, daemon.endpoint)
        yield daemon, bridge
        bridge.process.kill()
        bridge.process.wait()


@contextlib.contextmanager
def listening(broker: Broker) -> Iterator[HomeAssistant]:
    one = HomeAssistant(broker)
    try:
        yield one
    finally:
        one.close()


@needs_broker
def test_a_site_in_home_assistant(broker: Broker, bridged: tuple[Daemon, Bridge]) -> None:
    daemon, bridge = bridged
    events = numbered([*walkers(150), closing_event()])
    for event in events:
        daemon.bus.publish(f"event/{event.camera}", event, "event")
    wait_for(lambda: all_out(daemon, len(events)), "all to be learned")
    assert daemon.topology is not None
    assert daemon.topology.score is not None
    daemon.bus.publish(
        "prediction/a", msgspec.structs.replace(to_hall(0.2, ("b", 0.8)), camera="a"), "prediction"
    )
    daemon.bus.publish("status/c", {"state": "stalled", "reason": "no frame"}, "status")
    for key in ("status/a", "prediction/a", "status/daemon"):
        daemon.bus.publish_raw(key, b"\xc1", "status")  # nonsense changes nothing
    wild = msgspec.structs.replace(to_hall(1.0), camera="b", t=float("inf"))
    daemon.bus.publish("prediction/b", wild, "prediction")
    daemon.bus.publish("prediction/a", wild, "prediction")
    version, top1 = daemon.topology.version, daemon.topology.score.top1
    with listening(broker) as first:
        wait_for(lambda: first.of("daemon/state", "version") == version, "the version")
        wait_for(lambda: first.of("camera/a/prediction", "next") == "b", "the prediction")
        wait_for(
            lambda: first.of("camera/b/prediction", "next") == "leaves", "one of no time at all"
        )
        wait_for(lambda: first.of("camera/c/state", "reason") == "no frame", "a camera's reason")
        daemon.bus.publish("match/b", arrival("b").match, "match")
        wait_for(lambda: first.of("camera/b/arrival", "event_type") == "new", "an arrival")
        assert first.of("walk", "walk") == "b@1"
    assert bridge.process.poll() is None, bridge.said
    with listening(broker) as late:  # everything is retained
        passing = {"camtopod/site/walk", "camtopod/site/camera/b/arrival"}
        wait_for(lambda: first.heard.keys() - late.heard.keys() == passing, "the others, retained")
        assert late.of("daemon/state", "score") == round(100 * top1, 1)
        assert late.of("camera/a/state", "events") == daemon.status().cameras["a"].events
        assert late.of("camera/a/state", "zones") >= 2
        assert late.of("daemon/alarm", "alarm") == "none"
        configs = {topic for topic in late.heard if topic.startswith("homeassistant/")}
        assert configs == set(homeassistant.discovery(Topics("site"), ["a", "b", "c", "late"]))
        assert late.heard["camtopod/site/availability"] == "online"
        assert late.heard["camtopod/site/daemon/availability"] == "online"
        daemon.stop()
        wait_for(
            lambda: late.heard["camtopod/site/daemon/availability"] == "offline",
            "the daemon's absence",
        )
        wait_for(lambda: late.of("daemon/state", "problem") == "ON", "the problem")
        assert bridge.end(signal.SIGTERM) == exits.DONE
        wait_for(
            lambda: late.heard["camtopod/site/availability"] == "offline", "the bridge's absence"
        )


@needs_broker
def test_a_broker_that_forgot_everything_is_told_anew_and_a_killed_bridge_is_noticed(
    broker: Broker, bridged: tuple[Daemon, Bridge]
) -> None:
    _, bridge = bridged
    broker.stop()
    wait_for(lambda: "trying again" in bridge.said, "the loss to be noticed")
    assert broker.start()
    with listening(broker) as heard:
        wait_for(lambda: heard.of("daemon/state", "problem") == "OFF", "the states")
        wait_for(lambda: len(heard.heard) >= 3 + len(homeassistant.SITE_ENTITIES), "the entities")
        assert heard.heard["camtopod/site/availability"] == "online"
        assert bridge.end(signal.SIGKILL) == -signal.SIGKILL
        wait_for(
            lambda: heard.heard["camtopod/site/availability"] == "offline", "the broker to say so"
        )


@needs_broker
def test_what_cannot_be_reached_and_what_is_missing(
    broker: Broker,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    assert main(["bridge", "mqtt://u:hunter2-long@h/x"]) == exits.USAGE
    assert main(["bridge", "http://h"]) == exits.USAGE
    assert "write it like mqtt://HOST:1883/PREFIX" in capsys.readouterr().err
    meeting = buses.open_daemon_session(small_config(tmp_path))
    try:
        connect = ["--connect", meeting.endpoint]
        assert main([*connect, "bridge", "mqtt://127.0.0.1:1"]) == exits.FAILED
        monkeypatch.setitem(sys.modules, "paho.mqtt.client", None)
        assert main([*connect, "bridge", f"mqtt://127.0.0.1:{broker.port}"]) == exits.FAILED
    finally:
        meeting.close()
    said = capsys.readouterr().err
    assert "hunter2-long" not in said
    assert "cannot reach 127.0.0.1:1" in said
    assert "pip install 'camtopod[mqtt]'" in said
