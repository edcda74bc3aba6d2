"""The feed of the web server: its use of the bus, and bounded queues to open pages."""

from __future__ import annotations

import asyncio
import json
import math
import threading
from typing import Any, cast

import msgspec
import pytest
from fake_bus import OneBus
from model_rows import rows_of, with_rows
from synthetic_topology import synthetic_topology

from camtopod.records import (
    Camera,
    InView,
    Look,
    Match,
    MatchedPassage,
    NextCamera,
    Prediction,
    SeenEvent,
)
from camtopod.serve.bus import Bus
from camtopod.web import feed, recent_matches
from camtopod.web.feed import Feed
from camtopod.web.map_data import Map
from camtopod.web.outbox import MESSAGES_MAX, PAGES_MAX, PageQueue, PageQueues
from camtopod.words import ELSEWHERE, OLD_SECONDS, SILENT_SECONDS_MIN

SITE = synthetic_topology(12)
NAMES = [camera.id for camera in SITE.cameras]
SILENT_SECONDS = SILENT_SECONDS_MIN + 1.0
RUNNING = {"state": "running", "reason": ""}


class KeptMessages(PageQueues):
    """Queues that keep the messages to all pages."""

    def __init__(self) -> None:
        super().__init__()
        self.sent: list[tuple[str, Any]] = []
        self.is_open = False

    @property
    def is_any_open(self) -> bool:
        return self.is_open

    def send(
        self, name: str, content: bytes, camera: str | None = None, is_optional: bool = False
    ) -> None:
        self.sent.append((name, json.loads(content)))

    def of(self, kind: str) -> list[Any]:
        return [content for name, content in self.sent if name == kind]


class Rig:
    """A feed that follows the bus; time stands still unless it is moved."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.bus = OneBus()
        self.pages = KeptMessages()
        self.feed = Feed(cast(Bus, self.bus), self.pages, lambda: self.now)

    def rows(self) -> dict[str, dict[str, Any]]:
        """Return the rows of the health page by camera."""
        return {row["id"]: row for row in self.feed.health()["cameras"]}

    def states(self) -> dict[str, str]:
        return {name: row["state"] for name, row in self.rows().items()}


@pytest.fixture
def rig() -> Rig:
    return Rig()


def prediction(camera: str, *probabilities: float) -> Prediction:
    next_ = [NextCamera(f"c{k}", f"c{k}/1", p, 1.0, 2.0, 3.0) for k, p in enumerate(probabilities)]
    seen = [InView("b", "somebody", 5.0, 0.5), InView("b", "else", 5.0, 0.25)]
    look = [Look("c0", 0.9)]
    return Prediction(camera, f"{camera}/1", 1.0, "somebody", 1, 0.1, next_, look, seen)


def match(
    camera: str, t: float, came: str = "b", sure: float = 0.9, walk: str | None = None
) -> Match:
    earlier = [MatchedPassage(came, t - 5.0, sure, "somebody")]
    return Match(camera, t, 1, earlier, 1.0 - sure, walk or f"{came}@7", "somebody")


def shown_map(rig: Rig) -> Map:
    assert rig.feed.map is not None
    return rig.feed.map


def follow(rig: Rig) -> None:
    """Let the feed look after the bus once."""
    stop = threading.Event()
    rig.feed.follow(stop, stop.set)


# --- the feed


def test_versions_are_told_and_a_new_epoch_begins_anew(rig: Rig) -> None:
    rig.feed.show(SITE)
    rig.bus.publish("prediction/a", prediction("a", 0.9))
    rig.feed.show(msgspec.structs.replace(SITE, version=2, links=SITE.links[1:]))

    assert rig.pages.of("version") == [["01J", 1], ["01J", 2]]
    assert [one["version"] for one in rig.feed.versions] == [1, 2]
    assert b"event: past" in rig.feed.hello()

    rig.feed.show(msgspec.structs.replace(SITE, epoch="02K"))

    assert rig.pages.of("version")[-1] == ["02K", 1]
    assert json.loads(rig.feed.map_json)["epoch"] == "02K"
    assert [one["since"] for one in rig.feed.versions] == [None]
    assert b"event: past" not in rig.feed.hello()


def test_a_camera_that_was_added_is_on_the_map_before_a_version_knows_it(rig: Rig) -> None:
    rig.feed.show(SITE)
    places = {name: (node.x, node.y) for name, node in shown_map(rig).cameras.items()}
    rig.bus.publish("status/added", RUNNING)
    follow(rig)
    there = shown_map(rig).cameras

    assert {name for name, camera in there.items() if camera.new} == {"added"}
    assert json.loads(rig.feed.map_json)["cameras"]["added"]["new"] is True
    assert all(math.dist((there[name].x, there[name].y), at) < 0.5 for name, at in places.items())
    assert rig.pages.of("cameras") == [None], "open pages fetch the map"
    follow(rig)
    assert rig.pages.of("cameras") == [None], "once"

    known = [*SITE.cameras, Camera("added", [])]
    newer = msgspec.structs.replace(SITE, version=SITE.version + 1, cameras=known)
    rig.feed.show(with_rows(newer, rows_of(SITE)))
    assert not any(camera.new for camera in shown_map(rig).cameras.values())


def test_predictions_are_told_without_who_it_was_and_so_many_a_second(rig: Rig) -> None:
    for _ in range(feed.PER_SECOND_MAX + 10):
        rig.bus.publish("prediction/a", prediction("a", 0.4, 0.2, 0.1, 0.05))
    rig.bus.publish("prediction/a", {"not": "one"})
    told = rig.pages.of("prediction")
    rig.now += 1
    rig.bus.publish("prediction/b", prediction("b", 0.5))

    assert len(told) == feed.PER_SECOND_MAX
    assert len(told[0]["next"]) == feed.NEXT_SHOWN
    assert "track" not in told[0]
    assert told[0]["now"] == [{"camera": "b", "probability": 0.75}]
    assert told[0]["seconds"] == max(row["q90"] for row in told[0]["next"])
    words = "b 75 %, in view now; otherwise c0 40 %, in 1 to 3 s; c1 20 %, in 1 to 3 s"
    assert (told[0]["place"], told[0]["words"]) == ("b", words)
    assert rig.pages.of("prediction")[-1]["camera"] == "b", "the next second's"
    assert b"somebody" not in rig.feed.hello()
    assert rig.feed.hello().count(b"event: past") == feed.PREDICTIONS_HELD


def test_the_newest_events_are_asked_for_once_a_second_while_a_page_is_open(rig: Rig) -> None:
    def asked() -> list[Any]:
        return [given["since"] for key, given in rig.bus.asked if key == "recent"]

    rig.feed.ask_recent()
    assert asked() == [], "no page is open"

    rig.pages.is_open = True
    rig.feed.ask_recent()
    rig.feed.ask_recent()
    assert asked() == [math.inf], "nothing of before the page"
    rig.now += 1.0
    rig.bus.seen = [SeenEvent(5.0, "a", "exit", "a/1", 0.1, 0.2)] * (feed.SEEN_PER_SECOND_MAX + 1)
    rig.feed.ask_recent()

    (told,) = rig.pages.of("seen")
    assert len(told) == feed.SEEN_PER_SECOND_MAX
    assert told[0] == {"t": 5.0, "camera": "a", "kind": "exit", "zone": "a/1", "x": 0.1, "y": 0.2}
    assert math.isfinite(asked()[1]), "from the answer before on"


def test_it_says_since_when_and_why_it_is_not_live(rig: Rig) -> None:
    assert "no status of the daemon" in rig.feed.health()["live"]["reason"]
    rig.bus.publish("status/daemon", RUNNING)
    assert rig.feed.health()["live"]["live"]

    rig.now += SILENT_SECONDS
    silent = rig.feed.health()["live"]
    rig.bus.connected = False
    away = rig.feed.health()["live"]

    assert "no status from" in silent["reason"]
    assert "cannot be reached" in away["reason"]
    for live in (silent, away):
        assert (live["live"], live["words"], live["since"]) == (False, "silent", 1000.0)


def test_health_has_every_camera_that_anybody_knows_and_its_reason(rig: Rig) -> None:
    rig.feed.show(SITE)
    counted = {"b": {"events": 7, "newest": 990.0, "ahead": None, "alive": True}}
    daemon = {"state": "running", "cameras": counted, "reject_samples": {"malformed": ["secret"]}}
    rig.bus.publish("status/daemon", daemon)
    rig.bus.publish("status/no name", {"state": "stalled"})
    rig.bus.publish("status/c", ["not", "a", "status"])
    rig.bus.publish("status/odd", {"state": ["x"], "restarts": msgspec.msgpack.Ext(5, b"x")})
    rig.bus.publish("status/a", {"state": "stalled", "reason": 1000 * "x", "events": 3})

    rows = rig.rows()
    learned = rows_of(SITE).cameras[0].last_event
    assert set(rows) == {"a", "b", *NAMES}
    assert (rows["a"]["state"], rows["a"]["reason"]) == ("stalled", 500 * "x")
    assert (rows["b"]["state"], rows["b"]["events"]) == (ELSEWHERE, 7)
    assert (rows[NAMES[0]]["state"], rows[NAMES[0]]["newest"]) == ("no grabber", learned)
    assert "secret" not in str(rig.feed.health())


def test_a_camera_without_a_grabber_and_without_events_for_a_day_is_gone(rig: Rig) -> None:
    rig.feed.show(msgspec.structs.replace(SITE, model=None))  # which has later events
    gone, quiet, alive = NAMES[:3]
    old = SITE.as_of - OLD_SECONDS
    counted = {
        gone: {"newest": old - 1.0, "alive": False},
        quiet: {"newest": old + 1.0, "alive": False},
        alive: {"newest": old - 1.0, "alive": True},
    }
    rig.bus.publish("status/daemon", {**RUNNING, "cameras": counted})

    states = rig.states()
    assert [states[name] for name in (gone, quiet, alive)] == ["gone", "no grabber", ELSEWHERE]
    assert rig.rows()[gone]["newest"] == old - 1.0


def test_a_grabber_that_says_nothing_more_is_silent_but_not_while_the_bus_is_away(rig: Rig) -> None:
    rig.bus.publish("status/a", RUNNING)
    rig.bus.publish("status/film", {"state": "ended", "reason": "the file is at its end"})
    rig.now += 100
    rig.bus.connected = False
    follow(rig)
    rig.bus.connected = True
    assert rig.states()["a"] == "running"

    rig.now += SILENT_SECONDS
    assert rig.states() == {"a": "silent", "film": "ended"}, "a film has nothing more to say"
    assert "no status from" in rig.rows()["a"]["reason"]

    rig.bus.publish("status/a", RUNNING)
    assert rig.states()["a"] == "running"


def test_a_forgotten_camera_needs_no_attention_and_leaves_with_its_grabber(rig: Rig) -> None:
    for name in "ab":
        rig.bus.publish(f"status/{name}", RUNNING)
    rig.bus.publish("status/daemon", {**RUNNING, "names": {"forgotten": {"a": 3}}})

    assert rig.states() == {"a": "forgotten", "b": "running"}
    assert "--take-back a" in rig.rows()["a"]["reason"]
    rig.now += 100.0
    assert rig.states() == {"b": "silent"}


# --- queues of pages


def test_a_page_that_lags_gets_less_and_then_comes_back() -> None:
    async def lag() -> list[bytes | None]:
        queue = PageQueue()
        for _ in range(MESSAGES_MAX):
            queue.put(b"passing", is_optional=True)
        queue.put(b"must", is_optional=False)
        await asyncio.sleep(0)
        taken = [await queue.take() for _ in range(MESSAGES_MAX // 4 + 1)]
        for _ in range(MESSAGES_MAX + 1):
            queue.put(b"must", is_optional=False)
        await asyncio.sleep(0)
        return [*taken, await queue.take()]

    taken = asyncio.run(lag())

    assert taken == [*[b"passing"] * (MESSAGES_MAX // 4), b"must", None]


def test_pages_that_have_stopped_reading_keep_no_other_out() -> None:
    async def crowd() -> bool:
        queues = PageQueues()
        pages = [queues.open() for _ in range(PAGES_MAX)]
        assert None not in pages
        assert queues.open() is None
        for _ in range(MESSAGES_MAX + 1):
            queues.send("version", b"1")
        await asyncio.sleep(0)
        return queues.open() is not None

    assert asyncio.run(crowd())


def test_matches_are_told_without_who_it_was_and_so_many_a_second(rig: Rig) -> None:
    for k in range(feed.PER_SECOND_MAX + 10):
        rig.bus.publish("match/a", match("a", 900.0 + k))
    rig.bus.publish("match/a", {"not": "one"})
    rig.bus.publish("prediction/a", prediction("a", 0.4))
    told = rig.pages.of("match")

    assert len(told) == feed.PER_SECOND_MAX
    assert told[0] == {
        "camera": "a",
        "t": 900.0,
        "walk": "b@7",
        "passage": told[1]["passage"],
        "new": pytest.approx(0.1),
        "from": [{"camera": "b", "t": 895.0, "probability": 0.9}],
    }
    assert len(rig.pages.of("prediction")) == 1, "they do not take the place of predictions"
    assert len(rig.feed.walks(0.0)) == feed.PER_SECOND_MAX + 10, "each is kept"


def test_the_newest_match_of_each_entry_is_kept_for_an_hour(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    for t in (930.0, 910.0, 920.0):
        rig.bus.publish("match/a", match("a", t))
    rig.bus.publish("match/a", match("a", 920.0, sure=0.4))  # once more, 10 s later

    assert [(one.t, one.from_[0].probability) for one in rig.feed.walks(910.0)] == [
        (920.0, 0.4),
        (930.0, 0.9),
    ]

    rig.now = 915.0 + recent_matches.MATCHES_SECONDS
    assert [one.t for one in rig.feed.walks(-math.inf)] == [920.0, 930.0]

    monkeypatch.setattr(recent_matches, "MATCHES_MAX", 3)
    for k in range(5):
        rig.bus.publish("match/a", match("a", rig.now + k))
    assert [one.t for one in rig.feed.walks(-math.inf)] == [rig.now + k for k in (2, 3, 4)]


def test_matches_of_a_forgotten_camera_or_an_earlier_epoch_are_not_kept(rig: Rig) -> None:
    rig.feed.show(SITE)
    rig.bus.publish("match/a", match("a", 900.0, came="b"))
    rig.bus.publish("match/b", match("b", 901.0, came="a"))
    rig.bus.publish("match/c", match("c", 902.0, came="a", walk="d@8"))
    walks = {"begins there": "b@1", "passes there": "d@1"}
    for k, walk in enumerate(walks.values()):
        rig.bus.publish("match/a", match("a", 910.0 + k, came="c", walk=walk))
    rig.bus.publish("match/b", match("b", 905.0, came="d", walk=walks["passes there"]))
    rig.bus.publish("status/daemon", {"state": "running", "names": {"forgotten": {"b": 0}}})

    assert [one.camera for one in rig.feed.walks(0.0)] == ["c"]

    rig.feed.show(msgspec.structs.replace(SITE, epoch="02K"))
    assert rig.feed.walks(0.0) == []
