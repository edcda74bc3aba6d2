"""The feed of the web server: its use of the bus, and bounded queues to open pages."""

from __future__ import annotations

import asyncio
import json
import threading
from typing import Any, cast

import msgspec
from fake_bus import OneBus
from serving import wait_for
from synthetic_topology import synthetic_topology

from camtopod.publishers import GONE_SECONDS
from camtopod.records import Event, InView, Look, NextCamera, Prediction
from camtopod.serve.bus.session import Bus
from camtopod.web import feed, outbox
from camtopod.web.feed import Feed
from camtopod.web.outbox import BYTES_MAX, MESSAGES_MAX, PASSING_MAX, RESYNC, PageQueue, PageQueues

SITE = synthetic_topology(12)
NEWER = msgspec.structs.replace(SITE, version=2, links=SITE.links[1:])


class Heard(PageQueues):
    """A hub that stores messages."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[tuple[str, Any]] = []

    def send(
        self, name: str, content: bytes, camera: str | None = None, passing: bool = False
    ) -> None:
        self.told.append((name, json.loads(content)))

    def of(self, kind: str) -> list[Any]:
        return [content for name, content in self.told if name == kind]


class Rig:
    """A feed with its two loops running; time stands still unless it is moved."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.bus, self.hub = OneBus(), Heard()
        self.feed = Feed(cast(Bus, self.bus), self.hub, lambda: self.now, 1.0)
        self._stop = threading.Event()
        self._threads = [
            threading.Thread(target=work, args=[self._stop])
            for work in (self.feed.versions, self.feed.messages)
        ]

    def __enter__(self) -> Rig:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()


def prediction(camera: str, *probabilities: float) -> Prediction:
    following = [
        NextCamera(f"c{k}", f"c{k}/1", p, 1.0, 2.0, 3.0) for k, p in enumerate(probabilities)
    ]
    seen = [InView("c0", "somebody else", 0.5, 0.9)]
    return Prediction(
        camera, f"{camera}/1", 1.0, "somebody", 1, 0.1, following, [Look("c0", 0.9)], seen
    )


# --- the feed
# ---------------------------------------------------------------------------------------


def test_versions_are_told_as_changes_and_a_new_epoch_anew() -> None:
    rig = Rig()
    rig.feed.show(SITE)
    rig.feed.show(NEWER)
    rig.feed.show(msgspec.structs.replace(SITE, epoch="02K"))
    assert [name for name, _ in rig.hub.told] == ["resync", "map", "resync"]
    (told,) = rig.hub.of("map")
    assert (told["since"], told["version"]) == (1, 2)
    assert len(told["edges"]) <= 2 < len(SITE.pairs)
    assert json.loads(rig.feed.map_json)["epoch"] == "02K"


def test_predictions_are_told_without_who_it_was_and_so_many_a_second() -> None:
    with Rig() as rig:
        for _ in range(feed.PREDICTIONS_PER_SECOND_MAX + 10):
            rig.bus.publish("prediction/a", prediction("a", 0.4, 0.2, 0.1, 0.05))
        rig.bus.publish("prediction/a", {"not": "one"})
        rig.bus.publish("status/a", {"state": "stalled"})
        wait_for(lambda: bool(rig.hub.of("health")), "what came behind them")
        rig.now += 1
        rig.bus.publish("prediction/b", prediction("b", 0.5))
        wait_for(
            lambda: any(one["camera"] == "b" for one in rig.hub.of("prediction")),
            "the next second's",
        )
        told = rig.hub.of("prediction")
        assert len(told) <= feed.PREDICTIONS_PER_SECOND_MAX + 1
        assert len(told[0]["next"]) == 3
        assert "track" not in told[0]
        assert told[0]["now"] == [{"camera": "c0", "probability": 0.9}]
    assert b"somebody" not in rig.feed.hello()
    assert rig.feed.hello().count(b"event: past") == feed.PREDICTIONS_HELD


def test_who_sees_somebody_now_is_told_by_camera_and_not_by_track() -> None:
    in_view = [
        InView("b", "somebody", 5.0, 0.5),
        InView("c", "else", 5.0, 0.2),
        InView("b", "too", 5.0, 0.25),
    ]
    with Rig() as rig:
        rig.bus.publish(
            "prediction/a", msgspec.structs.replace(prediction("a", 0.4), in_view=in_view)
        )
        wait_for(lambda: bool(rig.hub.of("prediction")), "the prediction")
        (told,) = rig.hub.of("prediction")
    assert told["now"] == [{"camera": "b", "probability": 0.75}]
    assert b"somebody" not in rig.feed.hello()


def test_events_are_passed_on_while_somebody_watches_without_who_it_was() -> None:
    event = Event("a", "exit", 5.0, 0.1, 0.2, "somebody", "boot", 3)
    with Rig() as rig, rig.feed.watching("a"):
        with rig.feed.watching("a"):
            assert len(rig.bus.subscribed["event/a"]) == 1, "two pages, one subscription"
        rig.bus.publish("event/a", event)
        wait_for(lambda: bool(rig.hub.of("event")), "the event")
    assert rig.hub.of("event") == [{"camera": "a", "kind": "exit", "t": 5.0, "x": 0.1, "y": 0.2}]
    assert rig.bus.subscribed["event/a"] == []


def test_it_says_since_when_and_why_it_is_not_live() -> None:
    with Rig() as rig:
        rig.bus.publish("status/daemon", {"state": "running"})
        wait_for(lambda: [one["live"] for one in rig.hub.of("live")][-1:] == [True], "live")
        rig.now += feed.SILENT_STATUSES + 1
        wait_for(lambda: len(rig.hub.of("live")) == 2, "not live")
        rig.now += 30
        rig.bus.connected = False
        wait_for(lambda: len(rig.hub.of("live")) == 3, "another reason")
        rig.bus.connected = True
        rig.bus.publish("status/daemon", {"state": "running"})
        wait_for(lambda: rig.hub.of("live")[-1]["live"] is True, "live again")
    silent, away = rig.hub.of("live")[1:3]
    assert "no status from" in silent["reason"]
    assert "cannot be reached" in away["reason"]
    assert silent["since"] == away["since"] == 1001.0, "the reason is another, the silence the same"


def test_health_has_every_camera_that_anybody_knows_and_its_reason() -> None:
    with Rig() as rig:
        rig.feed.show(SITE)
        counted = {"b": {"events": 7, "newest": 990.0, "ahead": None, "alive": True}}
        rig.bus.publish(
            "status/daemon", {"state": "running", "cameras": counted, "reject_samples": ["secret"]}
        )
        rig.bus.publish("status/no name", {"state": "stalled"})
        rig.bus.publish("status/c", ["not", "a", "status"])
        rig.bus.publish("status/a", {"state": "stalled", "reason": "no frame"})
        wait_for(lambda: len(rig.hub.of("health")) == 1, "the change")
        rig.bus.publish("status/a", {"state": "stalled", "reason": "no frame", "events": 3})
        rig.bus.publish("status/a", {"state": "running", "reason": ""})
        wait_for(lambda: len(rig.hub.of("health")) == 2, "the next change, not what stayed")
        health = rig.feed.health()
    rows = {row["id"]: row for row in health["cameras"]}
    assert set(rows) == {"a", "b", *(camera.id for camera in SITE.cameras)}
    assert (rows["a"]["state"], rows["b"]["state"], rows["b"]["events"]) == (
        "running",
        "unknown",
        7,
    )
    assert rows["cam0000"]["state"] == "no grabber"
    assert rig.hub.of("health")[0]["reason"] == "no frame"
    assert (
        len(feed._row("a", {"reason": 10**6 * "x"}, None)["reason"]) == feed.REASON_CHARACTERS_MAX
    )
    assert "secret" not in str(health)


def test_a_page_that_has_just_begun_does_not_blame_a_daemon_it_has_given_no_time() -> None:
    with Rig() as rig:
        rig.bus.publish("status/a", {"state": "running"})
        wait_for(lambda: bool(rig.hub.of("health")), "the first look")
        rig.bus.publish("status/a", {"state": "stalled"})
        wait_for(lambda: len(rig.hub.of("health")) == 2, "the next look")
        assert rig.hub.of("live") == []
        rig.now += feed.SILENT_STATUSES + 1
        wait_for(lambda: bool(rig.hub.of("live")), "that nobody is there")
    (told,) = rig.hub.of("live")
    assert told == {
        "live": False,
        "reason": "no daemon has published its status yet",
        "since": 1000.0,
        "catching_up": None,
    }


def test_a_camera_without_a_grabber_and_without_events_for_a_day_is_gone() -> None:
    with Rig() as rig:
        rig.feed.show(SITE)
        names = [camera.id for camera in SITE.cameras]
        newest = {
            names[0]: SITE.as_of - GONE_SECONDS - 1.0,
            names[1]: SITE.as_of - GONE_SECONDS + 1.0,
            names[2]: SITE.as_of - GONE_SECONDS - 1.0,
        }
        counted = {
            name: {"events": 5, "newest": t, "alive": name == names[2]}
            for name, t in newest.items()
        }
        rig.bus.publish("status/daemon", {"state": "running", "cameras": counted})
        wait_for(lambda: rig.hub.of("live")[-1:] != [], "the daemon")
        rows = {row["id"]: row for row in rig.feed.health()["cameras"]}
        assert rows[names[0]]["state"] == "gone"
        assert rows[names[0]]["newest"] == newest[names[0]]
        assert rows[names[1]]["state"] == "no grabber"
        assert rows[names[2]]["state"] == "unknown", "somebody publishes for it"


def test_after_a_restart_of_the_daemon_the_last_event_is_the_learned_one() -> None:
    assert SITE.model is not None
    known = SITE.model.cameras[0]
    with Rig() as rig:
        rig.feed.show(SITE)
        rows = {row["id"]: row for row in rig.feed.health()["cameras"]}
        assert rows[known.camera]["newest"] == known.last_event


def test_where_views_overlap_a_prediction_says_where_to_look() -> None:
    said = feed.shown(prediction("lobby", 0.9))
    assert [(one.camera, one.probability) for one in said.look] == [("c0", 0.9)]
    assert [one.camera for one in said.now] == ["c0"]


def test_a_daemon_that_is_behind_is_told_in_whole_percent() -> None:
    with Rig() as rig:
        for share in (0.631, 0.634, 0.7):
            behind = {"seconds": 900.0, "share": share}
            rig.bus.publish("status/daemon", {"state": "running", "catching_up": behind})
        rig.bus.publish("status/daemon", {"state": "running", "catching_up": None})
        wait_for(lambda: rig.hub.of("live")[-1:] != [], "the first")
        wait_for(lambda: rig.hub.of("live")[-1]["catching_up"] is None, "that it has caught up")
        told = [one["catching_up"] for one in rig.hub.of("live")]
        assert told == [63, 70, None]
        assert all(one["live"] for one in rig.hub.of("live"))


def test_a_grabber_that_says_nothing_more_is_silent_whatever_it_said_last() -> None:
    def told() -> list[tuple[str, str]]:
        return [(one["id"], one["state"]) for one in rig.hub.of("health")]

    with Rig() as rig:
        rig.bus.publish("status/a", {"state": "running", "reason": ""})
        rig.bus.publish("status/film", {"state": "ended", "reason": "the file is at its end"})
        wait_for(lambda: len(told()) == 2, "both")
        rig.now += feed.SILENT_STATUSES + 1
        wait_for(lambda: len(told()) == 3, "the silence")
        rows = {row["id"]: row for row in rig.feed.health()["cameras"]}
        rig.bus.publish("status/a", {"state": "running", "reason": ""})
        wait_for(lambda: len(told()) == 4, "that it speaks again")
    assert told()[2:] == [("a", "silent"), ("a", "running")]
    assert (rows["a"]["state"], rows["film"]["state"]) == ("silent", "ended"), (
        "a film has nothing more to say"
    )
    assert "no status from" in rows["a"]["reason"]


def test_nobody_is_silent_while_the_bus_is_not_reached() -> None:
    with Rig() as rig:
        rig.bus.publish("status/daemon", {"state": "running"})
        rig.bus.publish("status/a", {"state": "running", "reason": ""})
        wait_for(lambda: bool(rig.hub.of("health")), "its word")
        rig.bus.connected = False
        rig.now += 100
        wait_for(lambda: "cannot be reached" in rig.hub.of("live")[-1]["reason"], "the bus away")
        assert [row["state"] for row in rig.feed.health()["cameras"]] == ["running"]
        rig.bus.connected = True
        wait_for(lambda: "no status from" in rig.hub.of("live")[-1]["reason"], "the bus back")
        rig.now += feed.SILENT_STATUSES + 1
        wait_for(lambda: len(rig.hub.of("health")) == 2, "the silence on a bus that is there")
    assert rig.hub.of("health")[1]["state"] == "silent"


def test_a_status_of_odd_types_ends_nothing() -> None:
    with Rig() as rig:
        rig.bus.publish(
            "status/a",
            {"state": ["x"], "reason": {"a": 1}, "restarts": msgspec.msgpack.Ext(5, b"x")},
        )
        rig.bus.publish("status/b", {"state": "running"})
        wait_for(lambda: len(rig.hub.of("health")) == 2, "what came behind it")
        assert len(rig.feed.health()["cameras"]) == 2


# --- mailboxes
# --------------------------------------------------------------------------------------


def test_a_page_that_lags_gets_less_and_then_starts_anew() -> None:
    async def lag() -> tuple[bytes | None, int]:
        box = PageQueue(None)
        for _ in range(PASSING_MAX + 5):
            box.put(b"passing.", passing=True)
        left_out = box.left_out
        for _ in range(MESSAGES_MAX):
            box.put(b"must.", passing=False)
        return await box.take(1), left_out

    taken, left_out = asyncio.run(lag())
    assert left_out == 5
    assert taken is not None
    assert taken.startswith(RESYNC)
    assert taken.count(b"must.") < MESSAGES_MAX


def test_versions_of_a_large_site_do_not_heap_up_for_a_page_that_lags() -> None:
    async def lag() -> list[bytes | None]:
        box = PageQueue(None)
        version = bytes(BYTES_MAX // 3)
        for _ in range(5):
            box.put(version, passing=False)
        lagging = await box.take(1)
        box.put(bytes(2 * BYTES_MAX), passing=False)
        return [lagging, await box.take(1)]

    lagging, alone = asyncio.run(lag())
    assert lagging is not None
    assert alone is not None
    assert lagging.startswith(RESYNC)
    assert len(lagging) <= BYTES_MAX
    assert len(alone) == 2 * BYTES_MAX


def test_messages_come_in_order_from_any_thread_to_those_they_are_for() -> None:
    async def listen() -> list[bytes | None]:
        hub = PageQueues()
        plain, watching = hub.open(None), hub.open("a")
        assert plain is not None
        assert watching is not None
        empty = await plain.take(0.01)

        def tell() -> None:
            hub.send("map", b"1")
            hub.send("event", b"2", camera="a", passing=True)

        threading.Thread(target=tell).start()
        taken = b""
        while b"data: 2" not in taken:
            taken += await watching.take(5) or b""
        first = await plain.take(5)
        hub.close()
        return [empty, first, taken, await plain.take(5)]

    empty, first, taken, end = asyncio.run(listen())
    assert (empty, end) == (b"", None)
    assert first == b"event: map\ndata: 1\n\n"
    assert taken == b"event: map\ndata: 1\n\nevent: event\ndata: 2\n\n"


def test_so_many_pages_and_no_more() -> None:
    async def fill() -> list[PageQueue | None]:
        hub = PageQueues()
        boxes = [hub.open(None) for _ in range(outbox.PAGES_MAX + 1)]
        hub.leave(cast(PageQueue, boxes[0]))
        return [*boxes, hub.open(None)]

    boxes = asyncio.run(fill())
    assert [box is None for box in boxes] == [False] * outbox.PAGES_MAX + [True, False]


def test_a_forgotten_camera_needs_no_attention_and_leaves_with_its_grabber() -> None:
    with Rig() as rig:
        a, b = (camera.id for camera in SITE.cameras[:2])
        for name in (a, b):
            rig.bus.publish(f"status/{name}", {"state": "running", "reason": ""})
        rig.bus.publish("status/daemon", {"state": "running", "names": {"forgotten": {a: 3}}})

        def states() -> dict[str, str]:
            return {row["id"]: row["state"] for row in rig.feed.health()["cameras"]}

        wait_for(lambda: states() == {a: "forgotten", b: "running"}, "what the daemon says")
        assert {"id": a, "state": "forgotten"}.items() <= rig.hub.of("health")[-1].items()
        assert f"--take-back {a}" in rig.hub.of("health")[-1]["reason"]

        rig.now += 100.0
        rig.bus.publish("status/daemon", {"state": "running", "names": {"forgotten": {a: 3}}})
        wait_for(lambda: states() == {b: "silent"}, "both grabbers to be missed")
        rig.bus.publish("status/daemon", {"state": "running", "names": {"forgotten": {}}})
        wait_for(lambda: states() == {a: "silent", b: "silent"}, "the name to be taken back")


def test_predictions_of_an_epoch_that_has_ended_are_not_shown() -> None:
    with Rig() as rig:
        rig.feed.show(SITE)
        rig.bus.publish("prediction/a", prediction("a", 0.9))
        wait_for(lambda: b"event: past" in rig.feed.hello(), "the prediction")
        rig.feed.show(NEWER)
        assert b"event: past" in rig.feed.hello()
        rig.feed.show(msgspec.structs.replace(SITE, epoch="another"))
        assert b"event: past" not in rig.feed.hello()
