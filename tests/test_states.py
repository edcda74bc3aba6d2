"""States, outcomes and alarms in words: each rule, and the same words on every display."""

from __future__ import annotations

import json
from typing import Any, cast

import pytest
from fake_bus import OneBus
from msgspec.structs import replace
from synthetic_topology import synthetic_topology

from camtopod.cli.commands import bridge, watch
from camtopod.cli.terminal import SiteState
from camtopod.export.homeassistant import Topics
from camtopod.records import (
    Alarm,
    CameraFigures,
    CatchingUp,
    DaemonStatus,
    InView,
    NamesStatus,
    NextCamera,
    Prediction,
    Status,
)
from camtopod.serve.bus import Bus
from camtopod.web.feed import Feed
from camtopod.web.outbox import PageQueues
from camtopod.words import (
    ELSEWHERE,
    LEAVES,
    OLD_SECONDS,
    STARTING,
    UNKNOWN,
    CameraState,
    alarms_in_words,
    camera_states,
    daemon_state,
    headline,
)

NOW = 1_700_000_000.0
OLD = NOW - OLD_SECONDS - 1.0
SLOW = Status("running", status_seconds=20.0)
ALIVE = CameraFigures(5, NOW, alive=True)


# --- cameras


@pytest.mark.parametrize(
    ("grabber", "figures", "state", "look", "alive"),
    [
        ((Status("running"), 0.0), ALIVE, "running", "good", True),
        ((Status("running"), 4.9), ALIVE, "running", "good", True),
        ((Status("running"), 5.1), ALIVE, "silent", "bad", False),
        ((SLOW, 49.0), ALIVE, "running", "good", True),
        ((SLOW, 51.0), ALIVE, "silent", "bad", False),
        ((SLOW, 51.0), CameraFigures(5, OLD), "gone", "off", False),
        ((Status("ended"), 99.0), None, "ended", "off", True),
        ((Status("stalled"), 0.0), ALIVE, "stalled", "bad", True),
        ((Status("blind"), 0.0), ALIVE, "blind", "bad", True),
        ((Status("stalled"), 0.0), CameraFigures(5, OLD), "stalled", "bad", False),
        ((Status("connecting"), 0.0), None, "connecting", "bad", True),
        ((Status("connecting", reason=STARTING[0]), 0.0), None, "connecting", "off", True),
        ((Status(), 0.0), ALIVE, ELSEWHERE, "off", True),
        (None, CameraFigures(5, OLD, alive=True), ELSEWHERE, "off", True),
        (None, CameraFigures(5, NOW), ELSEWHERE, "off", False),
        (None, CameraFigures(5, OLD), "gone", "off", False),
        (None, CameraFigures(0, NOW), "no grabber", "off", False),
    ],
)
def test_the_state_of_a_camera(
    grabber: tuple[Status, float] | None,
    figures: CameraFigures | None,
    state: str,
    look: str,
    alive: bool,
) -> None:
    def states(*forgotten: str) -> dict[str, tuple[str, str, bool]]:
        counted = {"a": figures, "other": ALIVE} if figures else {"other": ALIVE}
        names = NamesStatus(forgotten=dict.fromkeys(forgotten, 3))
        daemon = DaemonStatus("running", cameras=counted, names=names)
        found = camera_states(daemon, {"a": grabber} if grabber else {}, None, {})
        return {one.id: (one.state, one.look, one.alive) for one in found}

    assert states()["a"] == (state, look, alive)

    # Once it is forgotten it is only that, and nothing is left without its grabber.
    is_heard = grabber is not None and state not in ("silent", "gone")
    assert states("a").get("a") == (("forgotten", "off", False) if is_heard else None)


def test_a_grabber_that_does_not_say_its_interval_has_the_daemons() -> None:
    daemon = DaemonStatus("running", status_seconds=20.0)
    [state] = camera_states(daemon, {"a": (Status("running"), 49.0)}, None, {})
    assert state.state == "running"


def test_a_reason_says_more_than_the_state() -> None:
    names = NamesStatus(renamed={"before": "after"})
    daemon = DaemonStatus(names=names, cameras={"fast": CameraFigures(1, NOW, ahead=3.2)})
    status = {"before": Status("running"), "fast": Status("stalled", 1000 * "x")}
    grabbers = {name: (one, 0.0) for name, one in status.items()}
    fast, before = camera_states(daemon, grabbers, None, {})
    assert fast.reason == 500 * "x" + "; clock 3 s ahead"
    assert before.reason == "counts as after"


def test_a_camera_needs_attention_while_an_alarm_of_it_is_open() -> None:
    known = [camera.id for camera in ALARMED.cameras]
    alarms = [
        Alarm(1, NOW - 9.0, "camera_silent", known[0], "no event"),
        Alarm(2, NOW - 8.0, "camera_silent", known[1], "no event"),
        Alarm(3, NOW - 7.0, "camera_back", known[1], "events again"),
        Alarm(3, NOW - 7.0, "camera_silent", "lost", "no event"),
    ]
    names = NamesStatus(forgotten={known[2]: 3})
    daemon = DaemonStatus(names=names, cameras={known[0]: ALIVE, "lost": CameraFigures(1, OLD)})
    states = camera_states(daemon, {}, replace(ALARMED, alarms=alarms), {})
    [(camera, state, reason)] = [(s.id, s.state, s.reason) for s in states if s.look == "bad"]
    silent = f"camera silent {camera}: no event"
    assert (camera, state, reason) == (known[0], ELSEWHERE, silent)


def test_the_newest_event_of_a_camera_is_the_later_of_what_is_counted_and_learned() -> None:
    names = [camera.id for camera in ALARMED.cameras]
    counted = [NOW - 534.0, None, NOW - 1.0]
    cameras = {name: CameraFigures(1, t) for name, t in zip(names, counted, strict=False)}
    states = camera_states(
        DaemonStatus(cameras=cameras), {}, ALARMED, dict.fromkeys(names, NOW - 60.0)
    )
    newest = {state.id: state.newest for state in states}
    assert [newest[name] for name in names[:3]] == [NOW - 60.0, NOW - 60.0, NOW - 1.0]


def test_a_grabber_that_makes_events_however_well_is_none_of_a_recording() -> None:
    grabbers = {
        "fine": (Status("running"), 0.0),
        "silent": (Status("running"), 99.0),
        "starts": (Status("connecting", reason=STARTING[0]), 0.0),
        "film": (Status("ended"), 0.0),
        "other": (Status(), 0.0),
    }
    states = camera_states(DaemonStatus(cameras={"other": ALIVE}), grabbers, None, {})
    assert sorted(one.id for one in states if one.has_grabber) == ["fine", "silent", "starts"]


# --- the daemon


BAD = CameraState("a", "stalled", "", "bad", True, 1, NOW)
ALARMED = replace(
    synthetic_topology(4, as_of=NOW),
    alarms=[Alarm(k, NOW - k, "link_closed", f"a/{k}->b/1", "0.00 since") for k in range(3)],
)
SLOW_DAEMON = DaemonStatus("running", status_seconds=20.0)


@pytest.mark.parametrize(
    ("status", "quiet", "cameras", "alarmed", "live", "words", "look"),
    [
        (DaemonStatus(), 0.0, [], False, False, "silent", "bad"),
        (SLOW_DAEMON, 49.0, [], False, True, "running", "good"),
        (SLOW_DAEMON, 51.0, [], False, False, "silent", "bad"),
        (DaemonStatus("running"), 4.0, [], True, True, "running, 3 alarms", "warn"),
        (
            *(DaemonStatus("running"), 0.0, [BAD], True, True),
            *("running, 3 alarms, 1 camera needs attention", "bad"),
        ),
        (
            *(DaemonStatus("running"), 0.0, [BAD, BAD], False, True),
            *("running, 2 cameras need attention", "bad"),
        ),
        (DaemonStatus("running", warnings=["odd"]), 0.0, [], False, True, "running", "warn"),
        (DaemonStatus("degraded", "disk full"), 0.0, [], False, True, "degraded", "bad"),
        (
            *(DaemonStatus("running", catching_up=CatchingUp(60.0, 0.999)), 0.0, [], False, True),
            *("running, catching up, 99 %", "off"),
        ),
    ],
)
def test_the_state_of_the_daemon(
    status: DaemonStatus,
    quiet: float,
    cameras: list[CameraState],
    alarmed: bool,
    live: bool,
    words: str,
    look: str,
) -> None:
    alarms = alarms_in_words(ALARMED) if alarmed else []
    state = daemon_state(status, quiet, cameras, alarms)
    assert (state.live, state.words, state.look) == (live, words, look)


def test_an_alarm_is_open_for_a_day_unless_a_later_one_is_of_the_same_subject() -> None:
    alarms = [
        Alarm(1, NOW - OLD_SECONDS, "zone_new", "c/1", "too long ago"),
        Alarm(2, NOW - 9.0, "camera_silent", "a", "no event"),
        Alarm(3, NOW - 8.0, "link_closed", "a/1->b/2", "0.00 since"),
        Alarm(4, NOW - 7.0, "camera_back", "a", "events again"),
    ]
    said = alarms_in_words(replace(ALARMED, alarms=alarms))
    assert [one.title for one in said if one.open] == ["link closed a/1 → b/2"]
    assert [one.version for one in said] == [4, 3, 2, 1]
    assert str(alarms[2]) == "link closed a/1 → b/2: 0.00 since"


# --- predictions


def left(leave: float, *rows: NextCamera, seen: float = 0.0, prior: bool = False) -> Prediction:
    in_view = [InView("hall", "1", NOW, seen)] if seen else None
    return Prediction("a", "a/1", NOW, "7", 1, leave, [*rows], None, in_view, prior=prior)


def to(camera: str, share: float, prior: bool = False) -> NextCamera:
    return NextCamera(camera, f"{camera}/1", share, 6.0, 7.0, 10.0, prior)


@pytest.mark.parametrize(
    ("prediction", "place", "words"),
    [
        (left(0.4, to("hall", 0.6)), "hall", "hall 60 %, in 6 to 10 s; leaves the site 40 %"),
        (left(0.6, to("hall", 0.4)), LEAVES, "leaves the site 60 %; hall 40 %, in 6 to 10 s"),
        (
            *(left(0.407, to("hall", 0.35), to("bar", 0.243)), "hall"),
            "perhaps hall 35 %, in 6 to 10 s; leaves the site 41 %; bar 24 %, in 6 to 10 s",
        ),
        (
            *(left(0.2, to("hall", 0.45), to("bar", 0.35)), "hall"),
            "most likely hall 45 %, in 6 to 10 s; bar 35 %, in 6 to 10 s; leaves the site 20 %",
        ),
        (left(0.5, to("hall", 0.5)), "hall", ""),
        (left(0.4, to("a", 0.6)), "a", "back to a 60 %, in 6 to 10 s; leaves the site 40 %"),
        (left(1.0), LEAVES, "leaves the site 100 %"),
        (left(0.6, to("bar", 0.4), seen=0.51), "hall", ""),
        (left(0.6, to("bar", 0.4), seen=0.49), LEAVES, ""),
        (left(0.1, to("hall", 0.9, prior=True)), "hall", ""),
        (left(1.0, prior=True), UNKNOWN, UNKNOWN),
        (left(0.7, to("hall", 0.3), prior=True), UNKNOWN, UNKNOWN),
        (left(0.4, to("hall", 0.3), prior=True), "hall", "most likely hall 30 %, in 6 to 10 s"),
        (replace(left(1.0), zone=None), UNKNOWN, UNKNOWN),
    ],
)
def test_what_is_said_of_a_prediction(prediction: Prediction, place: str, words: str) -> None:
    said = headline(prediction)
    assert said.place == place
    assert said.words == (words or str(prediction))


def test_times_that_nobody_measured_are_not_told() -> None:
    guessed = left(0.1, to("hall", 0.5, prior=True), to("bar", 0.4, prior=True))
    words = "most likely hall 50 %, no times known yet; bar 40 %, no times known yet; leaves"
    assert str(guessed).startswith(words)
    both = left(0.1, to("hall", 0.5, prior=True), to("hall", 0.4))
    assert str(both).startswith("hall 90 %, in 6 to 10 s"), "those of the same camera that are"


# --- the displays


class Displays:
    """The page's data, the terminal and the MQTT bridge of one site, at one moment."""

    def __init__(self) -> None:
        bus = OneBus()
        bus.kept = {1: ALARMED}
        self.bus = bus
        self.feed = Feed(cast(Bus, bus), PageQueues(), lambda: NOW)
        self.feed.show(ALARMED)
        self.bridge = bridge.HomeAssistantState(cast(Bus, bus), Topics("hq"), 100)
        self.terminal = SiteState("hq", lambda: NOW)
        bus.subscribe("status/*", self.terminal.on_status)
        bus.subscribe("prediction/*", self.terminal.on_prediction)

    def words(self) -> tuple[str, dict[str, Any], dict[str, Any]]:
        """Return what the terminal, the page and the bridge say."""
        messages = self.bridge.messages(NOW)
        state = {
            topic.removeprefix("camtopod/hq/"): json.loads(text)
            for topic, text in messages.items()
            if text.startswith("{")
        }
        text = "\n".join(watch.parts(self.terminal, ALARMED, NOW))
        return text, self.feed.health(), state


def test_the_same_status_is_the_same_words_on_every_display() -> None:
    shown = Displays()
    names = NamesStatus(forgotten={"old": 1})
    figures = {"far": ALIVE, "bad": ALIVE, "lost": CameraFigures(1, OLD)}
    daemon = DaemonStatus("running", names=names, cameras=figures, warnings=["a sentence"])
    shown.bus.publish("status/daemon", daemon)
    shown.bus.publish("status/bad", Status("stalled", "no picture"))
    shown.bus.publish("status/old", Status("running"))
    unsure = left(0.407, to("hall", 0.35), to("bar", 0.243))
    shown.bus.publish("prediction/far", replace(unsure, camera="far", zone="far/1"))
    text, page, state = shown.words()

    words = "running, 3 alarms, 1 camera needs attention"
    assert page["live"]["words"] == state["daemon/state"]["state"] == words
    assert page["live"]["reason"] == state["daemon/state"]["reason"] == "a sentence"
    assert f"site hq: daemon {words} (a sentence), 0 events" in text
    assert (page["live"]["look"], state["daemon/state"]["problem"]) == ("bad", "ON")

    rows = {row["id"]: row for row in page["cameras"]}
    expected = {"far": ELSEWHERE, "bad": "stalled", "lost": "gone", "old": "forgotten"}
    for name, camera_words in expected.items():
        row, line = rows[name], next(one for one in text.split("\n") if one[2:].startswith(name))
        assert row["state"] == state[f"camera/{name}/state"]["state"] == camera_words
        assert row["reason"] == state[f"camera/{name}/state"]["reason"]
        assert line[23:].startswith(camera_words)
        assert line.rstrip().endswith(row["reason"])
        assert line.startswith("!") == (row["look"] == "bad") == (name == "bad")
    assert state["camera/old/state"]["online"] == "OFF"

    title = "link closed a/2 → b/1"
    assert shown.feed.map.alarms[0].title == state["daemon/alarm"]["alarm"] == title
    assert f"{title}: 0.00 since" in text

    said = "perhaps hall 35 %, in 6 to 10 s; leaves the site 41 %; bar 24 %, in 6 to 10 s"
    assert f"far/1 -> {said}" in text
    assert json.dumps(said)[1:-1].encode() in shown.feed.hello()
    told = state["camera/far/prediction"]
    assert (told["next"], told["words"]) == ("hall", said)
