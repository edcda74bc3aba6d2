"""The web server without a browser: responses, access and limits; the command."""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import pytest
import serving
from page_fixture import Shown
from serving import WAIT_SECONDS, free_endpoint, small_config, wait_for
from synthetic_topology import synthetic_topology

from camtopod.cli import exits, main
from camtopod.config.settings import BusSettings
from camtopod.serve import bus as buses
from camtopod.web import api, app, connections, outbox
from camtopod.web.login import Login

SITE = synthetic_topology(12)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    """Serve a version, and the picture of one camera."""
    folder = tmp_path_factory.mktemp("pictures")
    (folder / "cam0001.jpg").write_bytes(b"a picture")
    shown = Shown(SITE, pictures=folder)
    with shown.serving(further_names=("Maps.Example",)):
        wait_for(lambda: shown.ask("/data/map").content != b"null", "the map")
        yield shown


def test_every_answer_has_a_strict_policy(server: Shown) -> None:
    for path in ("/", "/static/main.js", "/data/map", "/nothing"):
        headers = server.ask(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "http" not in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["cache-control"] == "no-cache", "an upgrade is seen at once"


def test_what_it_tells(server: Shown) -> None:
    link = SITE.links[0]
    pair = list(SITE.pairs[-1].cameras)
    details = server.json(f"/data/link?from={link.from_}&to={link.to}&relation={link.relation}")

    assert details["why"]
    assert server.json("/data/map")["version"] == 1
    assert server.json("/data/camera/cam0001")["picture"] is True
    assert server.json("/data/camera/cam0002")["picture"] is False
    assert server.json(f"/data/pair/{pair[1]}/{pair[0]}")["cameras"] == pair
    assert [one["version"] for one in server.json("/data/versions")] == [1]
    assert server.json("/data/health")["live"]["live"] is False
    for path in ("/data/camera/x", "/data/pair/x/y", "/data/link"):
        answer = server.ask(path)
        assert (answer.status, "error" in json.loads(answer.content)) == (404, True), path
    assert server.ask("/data/map", "POST", "{}").status == 405, "it only reads"


def test_only_its_own_names_and_addresses_are_answered(server: Shown) -> None:
    strange = ("evil.example", "10.0.0.1.evil", "", "[::1")
    own = ("LocalHost:1234", "maps.example", socket.gethostname(), "[fe80::1]:8780", "10.0.0.1")
    for host in (*strange, *own):
        answer = server.ask("/data/map", host=host)
        assert answer.status == (421 if host in strange else 200), host
        assert "content-security-policy" in answer.headers
        assert (b"camtopod web --name" in answer.content) is (host in strange)


def test_only_pictures_of_cameras_leave_the_folder(server: Shown) -> None:
    picture = server.ask("/picture/cam0001")
    assert (picture.status, picture.headers["content-type"]) == (200, "image/jpeg")
    assert picture.content == b"a picture"
    for path in (
        "/picture/..%2Fsecret",
        "/picture/cam0002",
        "/picture/.",
        "/static/../app.py",
        "/static/%2e%2e/app.py",
    ):
        assert server.ask(path).status in (400, 404), path


def test_the_stream_begins_with_what_is(server: Shown) -> None:
    with urllib.request.urlopen(f"{server.address}live", timeout=20) as stream:
        lines = [stream.readline() for _ in range(7)]
    assert lines[-2:] == [b"event: version\n", b'data: ["01J",1]\n']


def test_a_page_too_many_is_told_so(server: Shown, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outbox, "PAGES_MAX", 1)
    with urllib.request.urlopen(f"{server.address}live", timeout=20):
        answer = server.ask("/live")
    assert (answer.status, "too many pages are open" in answer.text) == (503, True)


def test_idle_and_slow_clients_keep_nobody_out(server: Shown) -> None:
    with contextlib.ExitStack() as stack:
        place = ("127.0.0.1", server.port)
        crowd = [stack.enter_context(socket.create_connection(place, 20)) for _ in range(400)]
        stream = stack.enter_context(urllib.request.urlopen(f"{server.address}live", timeout=20))
        for byte in b"GET /data/map HTTP/1.1\r\n":
            for one in crowd[:200]:
                one.sendall(bytes([byte]))

        assert server.ask("/data/map").status == 200
        assert stream.readline() == b"retry: 1000\n"


def test_requests_that_wait_for_the_daemon_delay_no_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """60 of each kind, while the daemon hangs."""
    shown = Shown(synthetic_topology(4, version=50))
    released = threading.Event()
    asked: list[str] = []

    def hang(key: str, parameters: object = None, one: bool = False) -> list[tuple[str, bytes]]:
        asked.append(key)
        assert released.wait(WAIT_SECONDS)
        return []

    paths = ("/data/growth", "/report.html", "/data/recent", "/api/predict?camera=cam0001")
    with shown.serving(), ThreadPoolExecutor(60 * len(paths)) as pool:
        wait_for(lambda: shown.ask("/data/map").content != b"null", "the map")
        monkeypatch.setattr(shown.bus, "query", hang)
        answers = [pool.submit(shown.ask, path) for path in paths for _ in range(60)]
        try:
            wait_for(lambda: sum(one.done() for one in answers) >= 200, "the refusals")
            for path in ("/", "/data/health", "/data/map", "/static/main.js"):
                assert shown.ask(path).status == 200
            refused = [one.result() for one in answers if one.done()]
            waiting = len(asked)
        finally:
            released.set()
        statuses = [one.result().status for one in answers]

    assert {one.status for one in refused} == {503}
    assert "too many requests wait for the daemon" in refused[0].text
    assert waiting <= app.GATHERING_MAX + api.ASKING_MAX
    assert statuses.count(200) == app.GATHERING_MAX, "what there is"
    assert asked.count("topology") == app.GATHERING_MAX, "no further version is asked for"


def asking(stack: contextlib.ExitStack, port: int, text: str) -> socket.socket:
    """Return a connection that has sent ``text``."""
    made = stack.enter_context(socket.create_connection(("127.0.0.1", port), 20))
    made.sendall(text.encode())
    return made


def ended(connection: socket.socket) -> bool:
    """Wait for the end of a connection."""
    with contextlib.suppress(ConnectionResetError):
        while connection.recv(4096):
            pass
    return True


HALVES = [
    "POST /login HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\nabcd",
    "GET /data/map HTTP/1.1\r\nHost: loc",
    "GET /login HTTP/1.1\r\nHost: localhost\r\n\r\n" * 2 + "POST /login HTTP/1.1\r\nHost: loc",
    "",
]
"""Requests that are not whole."""


def test_who_never_ends_a_request_gives_its_place_to_the_newest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(connections, "CONNECTIONS_MAX", 12)
    shown = Shown(SITE, login=Login("correct horse", "a-token-of-enough-characters"))
    token = "Bearer a-token-of-enough-characters"
    with shown.serving() as port, contextlib.ExitStack() as stack:
        first = asking(stack, port, HALVES[0])
        for _ in range(12):
            for half in HALVES:
                asking(stack, port, half)
            assert shown.ask("/data/health", authorization=token).status == 200
        assert ended(first)


def test_a_request_has_one_deadline_and_a_stream_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "REQUEST_SECONDS", 0.3)
    shown = Shown(SITE, login=Login("correct horse", "a-token-of-enough-characters"))
    head = "GET /live HTTP/1.1\r\nHost: localhost\r\n"
    token = "Authorization: Bearer a-token-of-enough-characters\r\n"
    with shown.serving() as port, contextlib.ExitStack() as stack:
        stream = asking(stack, port, f"{head}{token}\r\n").makefile("rb")
        halves = [asking(stack, port, half) for half in HALVES]
        assert all(map(ended, halves))
        assert b"X-Accel-Buffering: no\r\n".lower() in {stream.readline().lower() for _ in range(9)}
        shown.publish(msgspec.structs.replace(SITE, version=2))
        while stream.readline() != b'data: ["01J",2]\n':
            pass


def test_errors_are_json_and_a_camera_that_is_none_is_named(server: Shown) -> None:
    for path, method, status in (
        ("/api/nope", "GET", 404),
        ("/nowhere", "GET", 404),
        ("/api/topology", "POST", 405),
        ("/api/predict?camera=nope", "GET", 404),
    ):
        answer = server.ask(path, method)
        assert (answer.status, [*json.loads(answer.content)]) == (status, ["error"]), path


# --- the command


def test_it_says_where_it_is_and_ends_when_told(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    config = msgspec.structs.replace(small_config(tmp_path), bus=BusSettings(listen=(endpoint,)))
    (tmp_path / "c.toml").write_text('[web]\nlisten = "127.0.0.1:0"\npictures = "none"\n')
    options = ("--config", f"{tmp_path}/c.toml")
    with contextlib.closing(buses.open_daemon_session(config)):
        process = serving.camtopod(
            "web", "--connect", endpoint, *options, stderr=subprocess.PIPE, stdout=subprocess.PIPE
        )
        assert process.stderr is not None
        warning, where = (process.stderr.readline().decode() for _ in range(2))
        with urllib.request.urlopen(where.split()[-1], timeout=20) as answer:
            assert b"camtopod" in answer.read()
        process.terminate()
        out, _ = process.communicate(timeout=20)

    said = f"[web] pictures {tmp_path}/none: no such directory; cameras are shown without pictures"
    assert warning.endswith(f" warning: {said}\n")
    assert " info: the page is at http://127.0.0.1:" in where
    assert (process.returncode, out) == (0, b"")


@pytest.mark.parametrize("where", ["nonsense", "127.0.0.1:99999"])
def test_a_wrong_address_is_told(capsys: pytest.CaptureFixture[str], where: str) -> None:
    assert main.main(["web", "--listen", where]) == exits.USAGE
    assert "write it like" in capsys.readouterr().err


def test_without_its_packages_it_names_the_extra(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    monkeypatch.delitem(sys.modules, "camtopod.web.app", raising=False)
    monkeypatch.delattr("camtopod.web.app", raising=False)
    assert main.main(["web"]) == exits.FAILED
    assert "web needs the package 'uvicorn'" in capsys.readouterr().err
