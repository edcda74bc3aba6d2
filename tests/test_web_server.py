"""The page's server: what it answers, to whom, and within which limits; no browser needed."""

from __future__ import annotations

import asyncio
import contextlib
import json
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest
import serving
from made_site import made_site
from serving import free_endpoint, small_config, wait_for

from camtopod import codec
from camtopod.cli import exits, main
from camtopod.cli.web import address, hosts, is_loopback, listening
from camtopod.config import BusSettings
from camtopod.records import Event, NextCamera, Prediction, Topology
from camtopod.serve import bus as buses
from camtopod.serve.bus import Bus, QueryError
from camtopod.web import app, feed, mailbox, pictures
from camtopod.web.feed import Feed
from camtopod.web.mailbox import MESSAGES_MAX, PASSING_MAX, RESYNC, Hub, Mailbox

SITE = made_site(12)
CLOSED = next(link for link in SITE.links if link.relation == "unseen")
NEWER = msgspec.structs.replace(SITE, version=2, links=[link for link in SITE.links if link != CLOSED])


class OneBus:
    """What the feed uses of a bus; the test is everybody else on it."""

    def __init__(self) -> None:
        self.connected = True
        self.endpoint = "tcp/127.0.0.1:1"
        self.subscribed: dict[str, list[Callable[[str, bytes], None]]] = {}
        self.kept: dict[int, Topology] = {}
        self.asked: list[tuple[str, Any]] = []

    def subscribe(self, key: str, on_message: Callable[[str, bytes], None]) -> Callable[[], None]:
        self.subscribed.setdefault(key, []).append(on_message)
        return lambda: self.subscribed[key].remove(on_message)

    def watch_alive(self, role: str, on_change: Callable[[str, bool], None]) -> None:
        on_change("daemon", True)

    def ask(self, key: str, parameters: dict[str, Any] | None = None) -> list[tuple[str, bytes]]:
        self.asked.append((key, parameters))
        if key != "topology":
            return []
        wanted = (parameters or {}).get("version", max(self.kept, default=0))
        if wanted not in self.kept:
            raise QueryError("not kept")
        return [(key, codec.to_pack(self.kept[wanted]))]

    def put(self, key: str, noun: object) -> None:
        pattern = key.split("/")[0] + "/*"
        for receive in [*self.subscribed.get(key, []), *self.subscribed.get(pattern, [])]:
            receive(key, codec.to_pack(noun))


class Heard(Hub):
    """A hub that keeps what was told."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[tuple[str, Any]] = []

    def tell(self, name: str, content: bytes, camera: str | None = None, passing: bool = False) -> None:
        self.told.append((name, json.loads(content)))

    def of(self, kind: str) -> list[Any]:
        return [content for name, content in self.told if name == kind]


class Rig:
    """A feed whose two loops run; time stands still unless it is moved."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.bus, self.hub = OneBus(), Heard()
        self.feed = Feed(cast(Bus, self.bus), self.hub, lambda: self.now, 1.0)
        self._stop = threading.Event()
        self._threads = [
            threading.Thread(target=work, args=[self._stop]) for work in (self.feed.versions, self.feed.messages)
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
    following = [NextCamera(f"c{k}", f"c{k}/1", p, 1.0, 2.0, 3.0) for k, p in enumerate(probabilities)]
    return Prediction(camera, f"{camera}/1", 1.0, "somebody", 1, 0.1, following)


# --- the feed ---------------------------------------------------------------------------------------


def test_versions_are_told_as_changes_and_a_new_epoch_anew() -> None:
    rig = Rig()
    rig.feed.use(SITE)
    rig.feed.use(NEWER)
    rig.feed.use(msgspec.structs.replace(SITE, epoch="02K"))
    assert [name for name, _ in rig.hub.told] == ["resync", "map", "resync"]
    (told,) = rig.hub.of("map")
    assert (told["since"], told["version"]) == (1, 2)
    assert len(told["edges"]) <= 2 < len(SITE.pairs)
    assert json.loads(rig.feed.map_json)["epoch"] == "02K"


def test_predictions_are_told_without_who_it_was_and_so_many_a_second() -> None:
    with Rig() as rig:
        for _ in range(feed.PREDICTIONS_PER_SECOND_MAX + 10):
            rig.bus.put("prediction/a", prediction("a", 0.4, 0.2, 0.1, 0.05))
        rig.bus.put("prediction/a", {"not": "one"})
        rig.bus.put("status/a", {"state": "stalled"})
        wait_for(lambda: bool(rig.hub.of("health")), "what came behind them")
        rig.now += 1
        rig.bus.put("prediction/b", prediction("b", 0.5))
        wait_for(lambda: any(one["camera"] == "b" for one in rig.hub.of("prediction")), "the next second's")
        told = rig.hub.of("prediction")
        assert len(told) <= feed.PREDICTIONS_PER_SECOND_MAX + 1
        assert len(told[0]["next"]) == 3
        assert told[0]["track"] is None
    assert b"somebody" not in rig.feed.hello()
    assert rig.feed.hello().count(b"event: past") == feed.PREDICTIONS_HELD


def test_events_are_passed_on_while_somebody_watches_without_who_it_was() -> None:
    event = Event("a", "exit", 5.0, 0.1, 0.2, "somebody", "boot", 3)
    with Rig() as rig, rig.feed.watching("a"):
        with rig.feed.watching("a"):
            assert len(rig.bus.subscribed["event/a"]) == 1, "two pages, one subscription"
        rig.bus.put("event/a", event)
        wait_for(lambda: bool(rig.hub.of("event")), "the event")
    assert rig.hub.of("event") == [{"camera": "a", "kind": "exit", "t": 5.0, "x": 0.1, "y": 0.2}]
    assert rig.bus.subscribed["event/a"] == []


def test_it_says_since_when_and_why_it_is_not_live() -> None:
    with Rig() as rig:
        rig.bus.put("status/daemon", {"state": "running"})
        wait_for(lambda: [one["live"] for one in rig.hub.of("live")][-1:] == [True], "live")
        rig.now += feed.SILENT_STATUSES + 1
        wait_for(lambda: len(rig.hub.of("live")) == 2, "not live")
        rig.now += 30
        rig.bus.connected = False
        wait_for(lambda: len(rig.hub.of("live")) == 3, "another reason")
        rig.bus.connected = True
        rig.bus.put("status/daemon", {"state": "running"})
        wait_for(lambda: rig.hub.of("live")[-1]["live"] is True, "live again")
    silent, away = rig.hub.of("live")[1:3]
    assert "has said nothing" in silent["reason"]
    assert "is not reached" in away["reason"]
    assert silent["since"] == away["since"] == 1001.0, "the reason is another, the silence the same"


def test_health_has_every_camera_that_anybody_knows_and_its_reason() -> None:
    with Rig() as rig:
        rig.feed.use(SITE)
        counted = {"b": {"events": 7, "newest": 990.0, "ahead": None, "alive": True}}
        rig.bus.put("status/daemon", {"state": "running", "cameras": counted, "reject_samples": ["secret"]})
        rig.bus.put("status/no name", {"state": "stalled"})
        rig.bus.put("status/c", ["not", "a", "status"])
        rig.bus.put("status/a", {"state": "stalled", "reason": "no frame"})
        wait_for(lambda: len(rig.hub.of("health")) == 1, "the change")
        rig.bus.put("status/a", {"state": "stalled", "reason": "no frame", "events": 3})
        rig.bus.put("status/a", {"state": "running", "reason": ""})
        wait_for(lambda: len(rig.hub.of("health")) == 2, "the next change, not what stayed")
        health = rig.feed.health()
    rows = {row["id"]: row for row in health["cameras"]}
    assert set(rows) == {"a", "b", *(camera.id for camera in SITE.cameras)}
    assert (rows["a"]["state"], rows["b"]["state"], rows["b"]["events"]) == ("running", "unknown", 7)
    assert rows["cam0000"]["state"] == "no grabber"
    assert rig.hub.of("health")[0]["reason"] == "no frame"
    assert len(feed._row("a", {"reason": 10**6 * "x"}, None)["reason"]) == feed.REASON_CHARACTERS_MAX
    assert "secret" not in str(health)


# --- mailboxes --------------------------------------------------------------------------------------


def test_a_page_that_lags_gets_less_and_then_starts_anew() -> None:
    async def lag() -> tuple[bytes | None, int]:
        box = Mailbox(None)
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


def test_messages_come_in_order_from_any_thread_to_those_they_are_for() -> None:
    async def listen() -> list[bytes | None]:
        hub = Hub()
        plain, watching = hub.open(None), hub.open("a")
        assert plain is not None
        assert watching is not None
        empty = await plain.take(0.01)

        def tell() -> None:
            hub.tell("map", b"1")
            hub.tell("event", b"2", camera="a", passing=True)

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
    async def fill() -> list[Mailbox | None]:
        hub = Hub()
        boxes = [hub.open(None) for _ in range(mailbox.PAGES_MAX + 1)]
        hub.leave(cast(Mailbox, boxes[0]))
        return [*boxes, hub.open(None)]

    boxes = asyncio.run(fill())
    assert [box is None for box in boxes] == [False] * mailbox.PAGES_MAX + [True, False]


# --- over HTTP --------------------------------------------------------------------------------------


class Server:
    """The application on a bus of its own, with two versions; pictures in ``folder``."""

    def __init__(self, port: int) -> None:
        self.address = f"http://127.0.0.1:{port}"

    def get(self, path: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
        request = urllib.request.Request(self.address + path, headers=headers)
        try:
            with urllib.request.urlopen(request, timeout=20) as answer:
                return answer.status, dict(answer.headers), answer.read()
        except urllib.error.HTTPError as error:
            with error:
                return error.code, dict(error.headers), error.read()

    def json(self, path: str) -> Any:
        status, _, body = self.get(path)
        assert status == 200, body
        return json.loads(body)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("pictures")
    (folder / "cam0001.jpg").write_bytes(b"a picture")
    bus = OneBus()
    bus.kept = {1: SITE, 2: NEWER}
    with (
        listening("127.0.0.1", 0) as listener,
        app.serving(cast(Bus, bus), listener, hosts("127.0.0.1"), folder, lambda: 1000.0, 1.0),
    ):
        one = Server(listener.getsockname()[1])
        wait_for(lambda: one.get("/data/map")[2] != b"null", "the map")
        yield one


def test_every_answer_has_a_strict_policy(server: Server) -> None:
    for path in ("/", "/static/main.js", "/data/map", "/nothing"):
        _, headers, _ = server.get(path)
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "http" not in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["cache-control"] == "no-cache", "an upgrade is seen at once"


def test_everything_the_page_names_is_there(server: Server) -> None:
    status, _, body = server.get("/")
    assert status == 200
    assert b"//" not in body.replace(b"<!doctype", b""), "nothing from elsewhere"
    for name in ("main.js", "app.css", "icon.svg", "map.js"):
        assert server.get(f"/static/{name}")[0] == 200


def test_what_it_tells(server: Server) -> None:
    assert server.json("/data/map")["version"] == 2
    assert server.json("/data/camera/cam0001")["picture"] is True
    assert server.json("/data/camera/cam0002")["picture"] is False
    pair = SITE.pairs[-1].cameras
    assert server.json(f"/data/pair/{pair[1]}/{pair[0]}")["cameras"] == list(pair)
    link = NEWER.links[0]
    told = server.json(f"/data/link?from={link.from_}&to={link.to}&relation={link.relation}")
    assert told["why"]
    assert [one["version"] for one in server.json("/data/versions")] == [2]
    assert server.json("/data/version/1")["version"] == 1
    assert [one["version"] for one in server.json("/data/versions")] == [1, 2]
    (gone,) = server.json("/data/changes/1/2")
    assert (gone["sign"], gone["subject"]) == ("-", [CLOSED.from_, CLOSED.to, "unseen"])
    assert server.json("/data/health")["live"]["live"] is False
    for path in ("/data/camera/x", "/data/pair/x/y", "/data/link", "/data/version/3", "/data/changes/1/9"):
        status, _, body = server.get(path)
        assert (status, "error" in json.loads(body)) == (404, True), path


def test_it_only_reads(server: Server) -> None:
    request = urllib.request.Request(f"{server.address}/data/map", data=b"{}", method="POST")
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(request, timeout=20)
    with refused.value:
        assert refused.value.code == 405


def test_another_name_for_this_machine_is_refused(server: Server) -> None:
    assert server.get("/data/map", Host="evil.example")[0] == 400
    assert server.get("/data/map", Host="localhost:1234")[0] == 200


def test_only_pictures_of_cameras_leave_the_folder(server: Server) -> None:
    status, headers, body = server.get("/picture/cam0001")
    assert (status, headers["content-type"], body) == (200, "image/jpeg", b"a picture")
    for path in (
        "/picture/..%2Fsecret",
        "/picture/cam0002",
        "/picture/.",
        "/static/../app.py",
        "/static/%2e%2e/app.py",
    ):
        assert server.get(path)[0] in (400, 404), path
    assert pictures.picture_of(None, "a") is None


def test_a_name_with_a_path_in_it_is_nobodys_picture(tmp_path: Path) -> None:
    folder = tmp_path / "pictures"
    folder.mkdir()
    for place in (tmp_path / "a.png", folder / "a.png"):
        place.write_bytes(b"")
    assert pictures.picture_of(folder, "a") == folder / "a.png"
    assert pictures.picture_of(folder, "../a") is None


def test_the_stream_begins_with_what_is_and_refuses_odd_names(server: Server) -> None:
    with urllib.request.urlopen(f"{server.address}/live?camera=cam0001", timeout=20) as stream:
        lines = [stream.readline() for _ in range(11)]
    assert b"event: live\n" in lines
    assert b'data: ["01J",2]\n' in lines
    assert server.get("/live?camera=*")[0] == 404


# --- the command ------------------------------------------------------------------------------------


def test_it_says_where_it_is_and_ends_when_told(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    config = msgspec.structs.replace(small_config(tmp_path), bus=BusSettings(listen=(endpoint,)))
    with contextlib.closing(buses.meet(config)):
        process = serving.camtopod(
            "web", "--connect", endpoint, "--listen", "127.0.0.1:0", stderr=subprocess.PIPE, stdout=subprocess.PIPE
        )
        assert process.stderr is not None
        line = process.stderr.readline().decode()
        assert line.startswith("the page is at http://127.0.0.1:"), line
        with urllib.request.urlopen(line.split()[-1], timeout=20) as answer:
            assert b"camtopod" in answer.read()
        process.terminate()
        out, _ = process.communicate(timeout=20)
    assert (process.returncode, out) == (0, b"")


def test_without_a_bus_it_says_so(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    settings = tmp_path / "c.toml"
    settings.write_text("[bus]\nconnect_seconds = 0.1\n", "utf-8")
    asked = ["--config", str(settings), "web", "--listen", "127.0.0.1:0", "--connect", free_endpoint()]
    assert main.main(asked) == exits.BUS
    assert "is `camtopod run` running there" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "status", "said"),
    [
        (["--listen", "nonsense"], exits.USAGE, "write it like"),
        (["--listen", "127.0.0.1:99999"], exits.USAGE, "write it like"),
        (["--pictures", "/nowhere"], exits.INPUT, "there is no such folder"),
    ],
)
def test_wrong_options_are_told(capsys: pytest.CaptureFixture[str], options: list[str], status: int, said: str) -> None:
    assert main.main(["web", *options]) == status
    assert said in capsys.readouterr().err


def test_a_port_that_is_taken_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with listening("127.0.0.1", 0) as taken:
        assert main.main(["web", "--listen", f"127.0.0.1:{taken.getsockname()[1]}"]) == exits.FAILED
    assert "choose another port" in capsys.readouterr().err


def test_without_its_packages_it_names_the_extra(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    monkeypatch.delitem(sys.modules, "camtopod.web.app", raising=False)
    monkeypatch.delattr("camtopod.web.app", raising=False)
    assert main.main(["web"]) == exits.FAILED
    assert "pip install 'camtopod[web]'" in capsys.readouterr().err


def test_only_loopback_is_for_this_machine_alone() -> None:
    assert address("[::1]:80") == ("::1", 80)
    assert [is_loopback(host) for host in ("127.0.0.1", "::1", "localhost", "0.0.0.0", "cam.example")] == [
        True, True, True, False, False,
    ]  # fmt: skip
    assert hosts("0.0.0.0") == ["*"]
