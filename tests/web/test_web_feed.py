"""The feed of the web server: its use of the bus, and bounded queues to open pages."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Iterator
from typing import Any, cast

import msgspec
import pytest
from fake_bus import OneBus
from serving import wait_for
from synthetic_topology import synthetic_topology

from camtopod.publishers import GONE_SECONDS
from camtopod.records import Event, InView, Look, NextCamera, Prediction
from camtopod.serve.bus.session import Bus
from camtopod.web import feed
from camtopod.web.feed import Feed
from camtopod.web.outbox import MESSAGES_MAX, RESYNC, PageQueue, PageQueues

SITE = synthetic_topology(12)
NAMES = [camera.id for camera in SITE.cameras]
SILENT_SECONDS = feed.SILENT_STATUSES + 1.0
RUNNING = {"state": "running", "reason": ""}


class KeptMessages(PageQueues):
    """Queues that keep the messages to all pages."""

    def __init__(self) -> None:
        super().__init__()
        self.sent: list[tuple[str, Any]] = []

    def send(
        self, name: str, content: bytes, camera: str | None = None, passing: bool = False
    ) -> None:
        self.sent.append((name, json.loads(content)))

    def of(self, kind: str) -> list[Any]:
        return [content for name, content in self.sent if name == kind]


class Rig:
    """A feed with its two loops running; time stands still unless it is moved."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.bus = OneBus()
        self.pages = KeptMessages()
        self.feed = Feed(cast(Bus, self.bus), self.pages, lambda: self.now, 1.0)

    def rows(self) -> dict[str, dict[str, Any]]:
        """Return the rows of the health page by camera."""
        return {row["id"]: row for row in self.feed.health()["cameras"]}

    def wait_for(self, kind: str, count: int) -> Any:
        """Wait until so many messages of a kind have been sent, and return the last."""
        wait_for(lambda: len(self.pages.of(kind)) >= count, f"{count} messages {kind}")
        return self.pages.of(kind)[-1]


@pytest.fixture
def rig() -> Iterator[Rig]:
    one = Rig()
    stop = threading.Event()
    loops = (one.feed.follow_versions, one.feed.follow_messages)
    threads = [threading.Thread(target=loop, args=[stop]) for loop in loops]
    for thread in threads:
        thread.start()
    yield one
    stop.set()
    for thread in threads:
        thread.join()


def prediction(camera: str, *probabilities: float) -> Prediction:
    next_ = [NextCamera(f"c{k}", f"c{k}/1", p, 1.0, 2.0, 3.0) for k, p in enumerate(probabilities)]
    seen = [InView("b", "somebody", 5.0, 0.5), InView("b", "else", 5.0, 0.25)]
    look = [Look("c0", 0.9)]
    return Prediction(camera, f"{camera}/1", 1.0, "somebody", 1, 0.1, next_, look, seen)


# --- the feed


def test_versions_are_told_as_changes_and_a_new_epoch_anew(rig: Rig) -> None:
    rig.feed.show(SITE)
    rig.bus.publish("prediction/a", prediction("a", 0.9))
    wait_for(lambda: b"event: past" in rig.feed.hello(), "the prediction")
    rig.feed.show(msgspec.structs.replace(SITE, version=2, links=SITE.links[1:]))
    change = rig.wait_for("map", 1)

    assert (change["since"], change["version"]) == (1, 2)
    assert len(change["edges"]) <= 2 < len(SITE.pairs)
    assert [one.version for one in rig.feed.versions] == [1, 2]
    assert b"event: past" in rig.feed.hello()

    rig.feed.show(msgspec.structs.replace(SITE, epoch="02K"))
    assert [name for name, _ in rig.pages.sent if name in ("map", "resync")] == [
        "resync",
        "map",
        "resync",
    ]
    assert json.loads(rig.feed.map_json)["epoch"] == "02K"
    assert [one.since for one in rig.feed.versions] == [None]
    assert b"event: past" not in rig.feed.hello()


def test_predictions_are_told_without_who_it_was_and_so_many_a_second(rig: Rig) -> None:
    for _ in range(feed.PREDICTIONS_PER_SECOND_MAX + 10):
        rig.bus.publish("prediction/a", prediction("a", 0.4, 0.2, 0.1, 0.05))
    rig.bus.publish("prediction/a", {"not": "one"})
    rig.bus.publish("status/a", {"state": "stalled"})
    rig.wait_for("health", 1)
    told = rig.pages.of("prediction")
    rig.now += 1
    rig.bus.publish("prediction/b", prediction("b", 0.5))
    wait_for(lambda: rig.pages.of("prediction")[-1]["camera"] == "b", "the next second's")

    assert len(told) == feed.PREDICTIONS_PER_SECOND_MAX
    assert len(told[0]["next"]) == feed.NEXT_SHOWN
    assert "track" not in told[0]
    assert told[0]["now"] == [{"camera": "b", "probability": 0.75}]
    assert told[0]["look"] == [{"camera": "c0", "probability": 0.9}]
    assert b"somebody" not in rig.feed.hello()
    assert rig.feed.hello().count(b"event: past") == feed.PREDICTIONS_HELD


def test_events_are_passed_on_while_somebody_watches_without_who_it_was(rig: Rig) -> None:
    with rig.feed.watching("a"):
        with rig.feed.watching("a"):
            assert len(rig.bus.subscribed["event/a"]) == 1, "two pages, one subscription"
        rig.bus.publish("event/a", Event("a", "exit", 5.0, 0.1, 0.2, "somebody", "boot", 3))
        event = rig.wait_for("event", 1)

    assert event == {"camera": "a", "kind": "exit", "t": 5.0, "x": 0.1, "y": 0.2}
    assert rig.bus.subscribed["event/a"] == []


def test_it_says_since_when_and_why_it_is_not_live(rig: Rig) -> None:
    rig.bus.publish("status/daemon", RUNNING)
    assert rig.wait_for("live", 1)["live"] is True
    rig.now += SILENT_SECONDS
    silent = rig.wait_for("live", 2)
    rig.now += 30
    rig.bus.connected = False
    away = rig.wait_for("live", 3)
    rig.bus.connected = True
    rig.bus.publish("status/daemon", RUNNING)
    wait_for(lambda: rig.pages.of("live")[-1]["live"] is True, "live again")

    assert "no status from" in silent["reason"]
    assert "cannot be reached" in away["reason"]
    assert silent["since"] == away["since"] == 1001.0, "the reason is another, the silence the same"


def test_health_has_every_camera_that_anybody_knows_and_its_reason(rig: Rig) -> None:
    assert SITE.model is not None
    rig.feed.show(SITE)
    counted = {"b": {"events": 7, "newest": 990.0, "ahead": None, "alive": True}}
    daemon = {"state": "running", "cameras": counted, "reject_samples": {"malformed": ["secret"]}}
    rig.bus.publish("status/daemon", daemon)
    rig.bus.publish("status/no name", {"state": "stalled"})
    rig.bus.publish("status/c", ["not", "a", "status"])
    rig.bus.publish("status/odd", {"state": ["x"], "restarts": msgspec.msgpack.Ext(5, b"x")})
    rig.bus.publish("status/a", {"state": "stalled", "reason": 1000 * "x"})
    stalled = rig.wait_for("health", 2)
    rig.bus.publish("status/a", {"state": "stalled", "reason": 1000 * "x", "events": 3})
    rig.bus.publish("status/a", RUNNING)
    rig.wait_for("health", 3)

    rows = rig.rows()
    learned = SITE.model.cameras[0].last_event
    assert stalled["reason"] == 500 * "x"
    assert set(rows) == {"a", "b", "odd", *NAMES}
    assert (rows["a"]["state"], rows["b"]["state"], rows["b"]["events"]) == (
        "running",
        "unknown",
        7,
    )
    assert (rows[NAMES[0]]["state"], rows[NAMES[0]]["newest"]) == ("no grabber", learned)
    assert "secret" not in str(rig.feed.health())
    assert len(rig.pages.of("health")) == 3, "the changes, not what stayed"


def test_a_camera_without_a_grabber_and_without_events_for_a_day_is_gone(rig: Rig) -> None:
    rig.feed.show(SITE)
    gone, quiet, alive = NAMES[:3]
    old = SITE.as_of - GONE_SECONDS
    counted = {
        gone: {"newest": old - 1.0, "alive": False},
        quiet: {"newest": old + 1.0, "alive": False},
        alive: {"newest": old - 1.0, "alive": True},
    }
    rig.bus.publish("status/daemon", {**RUNNING, "cameras": counted})
    rig.wait_for("live", 1)

    rows = rig.rows()
    states = [rows[name]["state"] for name in (gone, quiet, alive)]
    assert states == ["gone", "no grabber", "unknown"], "somebody publishes for the last"
    assert rows[gone]["newest"] == old - 1.0


def test_a_grabber_that_says_nothing_more_is_silent_but_not_while_the_bus_is_away(rig: Rig) -> None:
    rig.bus.publish("status/daemon", RUNNING)
    rig.bus.publish("status/a", RUNNING)
    rig.bus.publish("status/film", {"state": "ended", "reason": "the file is at its end"})
    rig.wait_for("health", 2)
    rig.bus.connected = False
    rig.now += 100
    wait_for(lambda: "cannot be reached" in rig.pages.of("live")[-1]["reason"], "the bus away")
    assert rig.rows()["a"]["state"] == "running"

    rig.bus.connected = True
    wait_for(lambda: "no status from" in rig.pages.of("live")[-1]["reason"], "the bus back")
    rig.now += SILENT_SECONDS
    silent = rig.wait_for("health", 3)
    assert (silent["id"], silent["state"]) == ("a", "silent")
    assert "no status from" in silent["reason"]
    assert rig.rows()["film"]["state"] == "ended", "a film has nothing more to say"

    rig.bus.publish("status/a", RUNNING)
    assert rig.wait_for("health", 4)["state"] == "running"


def test_a_forgotten_camera_needs_no_attention_and_leaves_with_its_grabber(rig: Rig) -> None:
    a, b = NAMES[:2]
    for name in (a, b):
        rig.bus.publish(f"status/{name}", RUNNING)

    def wait_for_states(forgotten: dict[str, int], **states: str) -> None:
        rig.bus.publish("status/daemon", {**RUNNING, "names": {"forgotten": forgotten}})
        wait_for(
            lambda: {name: row["state"] for name, row in rig.rows().items()} == states, str(states)
        )

    wait_for_states({a: 3}, **{a: "forgotten", b: "running"})
    assert f"--take-back {a}" in rig.pages.of("health")[-1]["reason"]
    rig.now += 100.0
    wait_for_states({a: 3}, **{b: "silent"})
    wait_for_states({}, **{a: "silent", b: "silent"})


# --- queues of pages


def test_a_page_that_lags_gets_less_and_then_starts_anew() -> None:
    async def lag() -> bytes | None:
        queue = PageQueue(None)
        for _ in range(MESSAGES_MAX):
            queue.put(b"passing.", passing=True)
        for _ in range(MESSAGES_MAX):
            queue.put(b"must.", passing=False)
        return await queue.take(1)

    taken = asyncio.run(lag())
    assert taken is not None
    assert taken.startswith(RESYNC)
    assert taken.count(b"must.") < MESSAGES_MAX
