"""The web server without a browser: responses, access and limits."""

from __future__ import annotations

import contextlib
import json
import logging
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest
import serving
from fake_bus import OneBus
from serving import free_endpoint, small_config, wait_for
from synthetic_topology import synthetic_topology

from camtopod.cli import exits, main
from camtopod.cli.commands.web import address, is_loopback, listening, names
from camtopod.config.settings import BusSettings
from camtopod.serve.bus import session as buses
from camtopod.serve.bus.session import Bus
from camtopod.web import app, connections, pictures

SITE = synthetic_topology(12)
CLOSED = next(link for link in SITE.links if link.relation == "unseen")
NEWER = msgspec.structs.replace(
    SITE, version=2, links=[link for link in SITE.links if link != CLOSED]
)


# --- over HTTP
# --------------------------------------------------------------------------------------


class Server:
    """The application on a fake bus, with two versions; pictures in ``folder``."""

    def __init__(self, port: int) -> None:
        self.port = port
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
        app.serving(cast(Bus, bus), listener, names("127.0.0.1"), folder, lambda: 1000.0, 1.0),
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
    assert server.json("/data/health")["live"]["live"] is False
    for path in (
        "/data/camera/x",
        "/data/pair/x/y",
        "/data/link",
    ):
        status, _, body = server.get(path)
        assert (status, "error" in json.loads(body)) == (404, True), path


def test_it_only_reads(server: Server) -> None:
    request = urllib.request.Request(f"{server.address}/data/map", data=b"{}", method="POST")
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(request, timeout=20)
    with refused.value:
        assert refused.value.code == 405


def test_another_name_for_this_machine_is_refused(server: Server) -> None:
    status, headers, body = server.get("/data/map", Host="evil.example")
    assert (status, "content-security-policy" in headers) == (421, True)
    assert b"camtopod web --name" in body
    assert server.get("/data/map", Host="LocalHost:1234")[0] == 200
    assert server.get("/data/map", Host="[::1]:1234")[0] == 200
    assert server.get("/data/map", Host="10.0.0.1")[0] == 421, "it listens to this machine alone"


def test_open_to_others_it_answers_to_addresses_and_to_names_it_was_given() -> None:
    with (
        listening("127.0.0.1", 0) as listener,
        app.serving(
            cast(Bus, OneBus()),
            listener,
            names("0.0.0.0", ["maps.example"]),
            None,
            lambda: 1000.0,
            1.0,
            True,
        ),
    ):
        server = Server(listener.getsockname()[1])
        hosts = (
            "10.0.0.1:8780",
            "[fe80::1]",
            "Maps.Example",
            socket.gethostname(),
            "evil.example",
            "10.0.0.1.evil",
        )
        assert [server.get("/data/map", Host=host)[0] for host in hosts] == [
            200,
            200,
            200,
            200,
            421,
            421,
        ]


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


def test_a_picture_that_may_not_be_read_is_none(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(folder: Path | None, camera: str) -> Path | None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(app, "picture_of", forbidden)
    assert server.json("/data/camera/cam0001")["picture"] is False
    assert server.get("/picture/cam0001")[0] == 404


def test_the_stream_begins_with_what_is_and_refuses_odd_names(server: Server) -> None:
    with urllib.request.urlopen(f"{server.address}/live?camera=cam0001", timeout=20) as stream:
        lines = [stream.readline() for _ in range(11)]
    assert b"event: live\n" in lines
    assert b'data: ["01J",2]\n' in lines
    assert server.get("/live?camera=*")[0] == 404


# --- clients that are idle or slow
# ------------------------------------------------------------------


@pytest.fixture
def crowd(server: Server) -> Iterator[Callable[[int], list[socket.socket]]]:
    """Open so many connections to the page."""
    opened: list[socket.socket] = []

    def more(count: int) -> list[socket.socket]:
        made = [socket.create_connection(("127.0.0.1", server.port), 20) for _ in range(count)]
        opened.extend(made)
        return made

    yield more
    for one in opened:
        one.close()


def test_idle_and_slow_clients_keep_nobody_out(
    server: Server, crowd: Callable[[int], list[socket.socket]], caplog: pytest.LogCaptureFixture
) -> None:
    crowd(300)
    slow = crowd(300)
    head = b"GET /data/map HTTP/1.1\r\nHost: 127.0.0.1\r\nX: " + b"x" * 1000
    with urllib.request.urlopen(f"{server.address}/live", timeout=20) as stream:
        for byte in head[:50]:
            for one in slow:
                with contextlib.suppress(OSError):  # it has been closed
                    one.sendall(bytes([byte]))
            began = time.monotonic()
            assert server.get("/data/map")[0] == 200
            assert time.monotonic() - began < 1.0
        assert stream.readline() == b"retry: 1000\n"
    said = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert len(said) <= 1, said


def test_of_many_that_wait_the_oldest_are_closed(
    server: Server, crowd: Callable[[int], list[socket.socket]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "GRACE_SECONDS", 0.0)
    waiting = crowd(connections.WAITING_MAX + 20)
    assert server.get("/data/map")[0] == 200
    wait_for(lambda: sum(closed(one) for one in waiting) >= 20, "the oldest to be closed")
    assert not any(closed(one) for one in waiting[40:])
    monkeypatch.setattr(connections, "GRACE_SECONDS", 60.0)
    more = crowd(connections.WAITING_MAX)
    assert server.get("/data/map")[0] == 200
    for one in more:  # their requests may be on their way
        one.setblocking(True)
        one.sendall(b"GET /data/map HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        assert one.recv(15) == b"HTTP/1.1 200 OK"


def closed(connection: socket.socket) -> bool:
    """Return True if the other side has closed the connection."""
    connection.setblocking(False)
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    except ConnectionError:
        return True


def test_a_request_has_to_come_in_time(
    server: Server, crowd: Callable[[int], list[socket.socket]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "REQUEST_SECONDS", 0.3)
    (idle,), (slow,), (used,) = crowd(1), crowd(1), crowd(1)
    used.sendall(b"GET /data/map HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
    assert used.recv(8) == b"HTTP/1.1"
    used.sendall(b"G")  # and no more of the next one

    def more() -> bool:
        with contextlib.suppress(OSError):
            slow.sendall(b"G")
        return closed(slow)

    wait_for(more, "the slow one to be closed")
    wait_for(lambda: closed(idle), "the idle one to be closed")
    used.setblocking(True)
    while used.recv(65536):
        pass
    monkeypatch.setattr(app, "BEAT_SECONDS", 0.2)
    with urllib.request.urlopen(f"{server.address}/live", timeout=20) as stream:
        for _ in range(6):  # which takes longer than the request may
            while stream.readline() != b"event: beat\n":
                pass


def test_a_client_that_takes_nothing_is_disconnected(
    server: Server, crowd: Callable[[int], list[socket.socket]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "SEND_TIMEOUT_SECONDS", 0.5)
    (greedy,) = crowd(1)
    ask = b"GET /static/map.js HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
    greedy.settimeout(5)
    with contextlib.suppress(TimeoutError, ConnectionError):
        greedy.sendall(ask * 2000)  # more than fits in all buffers between
    monkeypatch.setattr(connections, "REQUEST_SECONDS", 0.3)

    def gone() -> bool:
        try:
            greedy.sendall(ask)
        except TimeoutError:
            return False
        except ConnectionError:
            return True
        return False

    greedy.settimeout(0.1)
    wait_for(gone, "it to be disconnected")


def test_what_clients_do_wrong_is_said_once_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(connections.time, "monotonic", lambda: now)
    seldom, said = connections.Seldom(), []
    for second in range(150):
        now = 100.0 + second
        for text in ("a", "b") if second == 0 else ("a",):
            record = logging.LogRecord("x", logging.WARNING, "", 0, text, (), None)
            said += [(second, record.getMessage())] if seldom.filter(record) else []
    more = "(59 more since the last such message)"
    assert said == [(0, "a"), (0, "b"), (60, f"a {more}"), (120, f"a {more}")]


# --- the command
# ------------------------------------------------------------------------------------


def test_it_says_where_it_is_and_ends_when_told(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    config = msgspec.structs.replace(small_config(tmp_path), bus=BusSettings(listen=(endpoint,)))
    with contextlib.closing(buses.open_daemon_session(config)):
        process = serving.camtopod(
            "web",
            "--connect",
            endpoint,
            "--listen",
            "127.0.0.1:0",
            "--pictures",
            str(tmp_path / "none"),
            stderr=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert process.stderr is not None
        line = process.stderr.readline().decode()
        assert line.endswith(
            f" warning: --pictures {tmp_path}/none: no such directory; cameras are shown without pictures\n"
        )
        line = process.stderr.readline().decode()
        assert " info: the page is at http://127.0.0.1:" in line, line
        with urllib.request.urlopen(line.split()[-1], timeout=20) as answer:
            assert b"camtopod" in answer.read()
        process.terminate()
        out, _ = process.communicate(timeout=20)
    assert (process.returncode, out) == (0, b"")


def test_without_a_bus_it_says_so(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    settings = tmp_path / "c.toml"
    settings.write_text("[bus]\nconnect_seconds = 0.1\n", "utf-8")
    asked = [
        "--config",
        str(settings),
        "web",
        "--listen",
        "127.0.0.1:0",
        "--connect",
        free_endpoint(),
    ]
    assert main.main(asked) == exits.BUS
    assert "is `camtopod run` running there" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "status", "said"),
    [
        (["--listen", "nonsense"], exits.USAGE, "write it like"),
        (["--listen", "127.0.0.1:99999"], exits.USAGE, "write it like"),
    ],
)
def test_wrong_options_are_told(
    capsys: pytest.CaptureFixture[str], options: list[str], status: int, said: str
) -> None:
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
    assert [
        is_loopback(host) for host in ("127.0.0.1", "::1", "localhost", "0.0.0.0", "cam.example")
    ] == [
        True,
        True,
        True,
        False,
        False,
    ]
