"""Health means progress: heartbeats of loops, the health endpoints, systemd's watchdog."""

from __future__ import annotations

import contextlib
import http.client
import json
import logging
import os
import signal
import socket
import sqlite3
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from fake_systemd import Systemd
from serving import T0, WAIT_SECONDS, camtopod, free_endpoint, small_config, wait_for

from camtopod.records import Event
from camtopod.serve import bus as buses, daemon as daemons
from camtopod.serve.daemon import Daemon
from camtopod.serve.monitoring import health
from camtopod.serve.runtime import systemd
from camtopod.serve.runtime.progress import Progress

# --- marks ----------------------------------------------------------------------------------------


def test_a_loop_that_does_not_get_on_is_named_and_one_that_does_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 100.0
    monkeypatch.setattr(
        "camtopod.serve.runtime.progress.time", SimpleNamespace(monotonic=lambda: now)
    )
    progress = Progress()
    receive = progress.watch("receive", 30.0)
    learn = progress.watch("learn", 900.0)
    assert progress.stalled() == []
    now += 31.0
    learn.beat()
    assert progress.stalled() == ["receive has made no progress for 31 s (limit: 30 s)"]
    receive.beat()
    now += 29.0
    assert progress.stalled() == []
    now += 1000.0
    assert [reason.split()[0] for reason in progress.stalled()] == ["learn", "receive"]

    progress.unwatch("receive")
    assert [reason.split()[0] for reason in progress.stalled()] == ["learn"]


# --- the daemon's loops ---------------------------------------------------------------------------


@pytest.fixture
def daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Daemon]:
    monkeypatch.setattr(daemons, "STALL_SECONDS", 0.4)
    monkeypatch.setattr(daemons, "LEARN_SECONDS", 0.4)
    one = Daemon(small_config(tmp_path))
    one.start()
    yield one
    one.stop()


def put(daemon: Daemon, *events: Event) -> None:
    assert daemon._bus is not None
    for event in events:
        daemon._bus.publish(f"event/{event.camera}", event, "event")


def stuck_in(owner: Any, name: str, monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Make ``owner.name`` block; return a function that releases it."""
    go = threading.Event()
    real = getattr(owner, name)

    def blocking(*given: Any, **named: Any) -> Any:
        assert go.wait(WAIT_SECONDS)
        return real(*given, **named)

    monkeypatch.setattr(owner, name, blocking)
    return go.set


def stopped(daemon: Daemon) -> Callable[[], None]:
    """Stop the learner's process; return a function that resumes it."""
    assert daemon._process is not None
    pid = daemon._process.pid
    os.kill(pid, signal.SIGSTOP)
    return lambda: os.kill(pid, signal.SIGCONT)


def test_each_loop_is_watched(daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> None:
    for owner, name, loop in (
        (daemon._intake, "step", "receive"),
        (daemon._journal, "commit", "store"),
    ):
        let_go = stuck_in(owner, name, monkeypatch)
        put(daemon, Event("lobby", "entry", T0))
        wait_for(
            lambda loop=loop: [reason.split()[0] for reason in daemon.failing()] == [loop],  # type: ignore[misc]
            f"{loop} to be named",
        )

        let_go()
        wait_for(lambda: daemon.failing() == [], "it to go on")


def test_a_full_disk_is_not_ready_but_starting_again_would_not_help(
    daemon: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = True
    commit = daemon._journal.commit

    def failing(*given: Any, **named: Any) -> Any:
        if full:
            raise sqlite3.OperationalError("database or disk is full")
        return commit(*given, **named)

    monkeypatch.setattr(daemon._journal, "commit", failing)
    put(daemon, Event("lobby", "entry", T0))
    wait_for(lambda: daemon.unready() != [], "not ready")
    assert "disk is full" in daemon.unready()[0]
    time.sleep(0.7)  # longer than any loop is allowed
    wait_for(lambda: daemon.failing() == [], "no loop to be stuck")
    full = False
    wait_for(lambda: daemon.unready() == [], "ready again")


def test_not_ready_before_the_start_and_after_the_stop(tmp_path: Path) -> None:
    daemon = Daemon(small_config(tmp_path))
    assert daemon.unready() == ["the daemon is starting"]
    assert daemon.failing() == []
    daemon.start()
    assert daemon.unready() == []
    daemon.stop()
    assert daemon.unready() == ["the daemon is stopping"]


def test_a_daemon_that_dials_is_ready_while_it_reaches_the_bus(tmp_path: Path) -> None:
    meeting = buses.open_daemon_session(small_config(tmp_path))
    with Daemon(small_config(tmp_path / "state", meeting.endpoint)) as daemon:
        assert daemon.unready() == []
        meeting.close()
        wait_for(
            lambda: daemon.unready() == [f"the bus at {meeting.endpoint} is not reached"],
            "not ready",
        )
        assert daemon.failing() == []


# --- the pages ------------------------------------------------------------------------------------


class Pages:
    """The two health endpoints, with answers set by the test."""

    def __init__(self) -> None:
        self.failing: list[str] = []
        self.unready: list[str] = []
        self._serving = health.serving("127.0.0.1:0", lambda: self.failing, lambda: self.unready)
        self.address = self._serving.__enter__()
        host, _, port = self.address.rpartition(":")
        self.at = (host, int(port))

    def ask(self, path: str, method: str = "GET") -> tuple[int, Any]:
        connection = http.client.HTTPConnection(*self.at, timeout=WAIT_SECONDS)
        try:
            connection.request(method, path)
            answer = connection.getresponse()
            body = answer.read()
            return answer.status, json.loads(body) if body.startswith(b"{") else body
        finally:
            connection.close()

    def send(self, raw: bytes) -> bytes:
        """Send these bytes and return the answer."""
        with socket.create_connection(self.at, timeout=WAIT_SECONDS) as client:
            got = b""
            try:
                client.sendall(raw)
                while more := client.recv(65536):
                    got += more
            except ConnectionError:
                pass
            return got

    def close(self) -> None:
        self._serving.__exit__(None, None, None)


@pytest.fixture
def pages() -> Iterator[Pages]:
    one = Pages()
    yield one
    one.close()


def test_pages(pages: Pages) -> None:
    assert pages.ask("/healthz") == (200, {"status": "ok", "reasons": []})
    assert pages.ask("/readyz?x=1") == (200, {"status": "ok", "reasons": []})
    pages.failing, pages.unready = ["learn has made no progress"], ["replaying"] * 100
    assert pages.ask("/healthz") == (
        503,
        {"status": "failing", "reasons": ["learn has made no progress"]},
    )
    status, body = pages.ask("/readyz")
    assert (status, len(body["reasons"])) == (503, 20)


def test_other_methods_paths_and_garbage(pages: Pages) -> None:
    assert pages.ask("/healthz", "POST")[0] == 501
    for path in ("/healthz/", "/../etc/passwd", "/%68ealthz/x"):
        status, body = pages.ask(path)
        assert status == 404
        assert b"/healthz" in body

    assert b"200" not in pages.send(b"GET /healthz HTTP/1.1\r\nX: " + b"x" * 100_000 + b"\r\n\r\n")
    assert b"200" not in pages.send(b"\x00" * 4096 + b"\r\n")
    assert pages.ask("/healthz")[0] == 200


def test_a_silent_client_delays_nobody_and_is_disconnected(
    pages: Pages, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(health, "REQUEST_SECONDS", 0.3)

    with socket.create_connection(pages.at, timeout=WAIT_SECONDS) as silent:
        assert pages.ask("/healthz")[0] == 200
        assert silent.recv(1) == b""

    # Nor does a byte now and then keep a place.
    with socket.create_connection(pages.at, timeout=WAIT_SECONDS) as slow:
        wait_for(lambda: gone(slow), "the end of one that sends a byte now and then")


def gone(slow: socket.socket) -> bool:
    """Send a byte; return True if the connection was closed."""
    try:
        slow.sendall(b"G")
    except ConnectionError:
        return True
    return False


def test_idle_connections_keep_nobody_out(pages: Pages, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(health, "CONNECTIONS_MAX", 4)
    with contextlib.ExitStack() as stack:
        idle = [
            stack.enter_context(socket.create_connection(pages.at, timeout=WAIT_SECONDS))
            for _ in range(20)
        ]
        for _ in range(3):
            assert pages.ask("/healthz")[0] == 200
        assert idle[0].recv(1) == b"", "the newest takes the oldest one's place"


# --- systemd --------------------------------------------------------------------------------------


@pytest.fixture
def systemd_socket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Systemd]:
    one = Systemd(str(tmp_path / "notify"))
    monkeypatch.setenv("NOTIFY_SOCKET", one.address)
    monkeypatch.setenv("WATCHDOG_USEC", "150000")
    yield one
    one.close()


def test_systemd_is_told_where_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    systemd.notify("READY=1")  # nobody is there: no error
    for address in (str(tmp_path / "notify"), f"@camtopod-test-{os.getpid()}"):
        one = Systemd(address)
        monkeypatch.setenv("NOTIFY_SOCKET", address)
        systemd.notify("READY=1", systemd.status("all\nis well"))
        assert one.hear() == ["READY=1", "STATUS=all is well"]
        before = time.monotonic()
        systemd.reloading()
        reloading, since = one.hear()
        assert reloading == "RELOADING=1"
        microseconds = int(since.removeprefix("MONOTONIC_USEC="))
        assert before <= microseconds / 1e6 + 1e-6 <= time.monotonic() + 1e-6
        one.close()
        systemd.notify("READY=1")  # nor is anybody now


def test_a_daemon_whose_learner_hangs_does_not_feed_the_watchdog(
    daemon: Daemon, systemd_socket: Systemd, caplog: pytest.LogCaptureFixture
) -> None:
    with systemd.watchdog(daemon.failing, lambda: not daemon.started):
        systemd_socket.wait_for("WATCHDOG=1")
        let_go = stopped(daemon)
        put(daemon, Event("lobby", "entry", T0))
        wait_for(lambda: daemon.failing() != [], "it to be noticed")
        assert daemon.unready() != []
        status = daemon.status()
        assert (status.state, "learn has made no progress" in status.reason) == ("degraded", True)
        systemd_socket.hear(0.2)
        assert "WATCHDOG=1" not in systemd_socket.hear(0.5)
        assert any(
            line.startswith("STATUS=learn has made no progress") for line in systemd_socket.told
        )
        with caplog.at_level(logging.INFO):
            let_go()
            wait_for(lambda: "WATCHDOG=1" in systemd_socket.hear(), "it to be fed again")
        assert "making progress again" in caplog.text


# --- the real program -----------------------------------------------------------------------------


class Program:
    """`camtopod` in a process of its own, under a fake systemd."""

    def __init__(self, directory: Path, systemd_socket: Systemd) -> None:
        self.directory, self.systemd = directory, systemd_socket
        self.endpoint = free_endpoint()
        self.file = directory / "c.toml"
        self.process: subprocess.Popen[bytes] | None = None

    def configure(self, rest: str = "") -> None:
        self.file.write_text(
            f'[bus]\nlisten = ["{self.endpoint}"]\n[state]\ndirectory = "{self.directory}/state"\n'
            f'[health]\nlisten = "127.0.0.1:0"\n{rest}'
        )

    def start(self, *arguments: str) -> None:
        with (self.directory / "log").open("ab") as log:
            self.process = camtopod("--config", str(self.file), *arguments, stderr=log)

    @property
    def log(self) -> str:
        return (self.directory / "log").read_text()

    def signal(self, number: int) -> None:
        assert self.process is not None
        self.process.send_signal(number)

    def end(self) -> int:
        assert self.process is not None
        return self.process.wait(WAIT_SECONDS)


@pytest.fixture
def program(tmp_path: Path, systemd_socket: Systemd) -> Iterator[Program]:
    one = Program(tmp_path, systemd_socket)
    yield one
    if one.process is not None and one.process.poll() is None:
        one.process.kill()
        one.process.wait()


def test_the_daemon_under_systemd_from_start_to_end(program: Program) -> None:
    program.configure()
    program.start("run")
    program.systemd.wait_for("READY=1")
    program.systemd.wait_for("WATCHDOG=1")
    assert f"STATUS=running at {program.endpoint}" in program.systemd.told
    address = program.log.split("health at http://")[1].split("/healthz")[0]
    connection = http.client.HTTPConnection(address, timeout=WAIT_SECONDS)
    connection.request("GET", "/readyz")
    assert connection.getresponse().status == 200
    connection.close()

    program.signal(signal.SIGTERM)
    assert program.end() == 0
    program.systemd.wait_for("STOPPING=1")
    assert "ended cleanly" in program.log


def test_a_grabber_under_systemd_and_one_that_is_stopped(program: Program) -> None:
    with socket.create_server(
        ("127.0.0.1", 0)
    ) as silent:  # accepts and says nothing: the loop gets on all the same
        program.configure(
            f'[cameras.lobby]\nsource = "rtsp://127.0.0.1:{silent.getsockname()[1]}/x"\n'
        )
        program.start("grab", "--camera", "lobby")
        program.systemd.wait_for("READY=1")
        program.systemd.told.clear()
        program.systemd.wait_for("WATCHDOG=1")
        program.signal(signal.SIGSTOP)
        program.systemd.hear(0.2)
        assert program.systemd.hear(0.5) == []
        program.signal(signal.SIGCONT)
        program.systemd.told.clear()
        program.systemd.wait_for("WATCHDOG=1")
        program.signal(signal.SIGTERM)
        assert program.end() == 0
