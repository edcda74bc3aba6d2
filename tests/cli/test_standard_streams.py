"""Programs whose standard error is closed or not read, and closed standard input and output."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import serving
from paths import ROOT
from serving import free_endpoint, small_config, wait_for

from camtopod.cli.terminal.standard_streams import NonBlockingStream
from camtopod.config.settings import BusSettings
from camtopod.serve.bus import session as buses

END_SECONDS = 30.0


@pytest.fixture
def full() -> Iterator[tuple[int, int]]:
    """Return both ends of a full pipe, for reading and writing."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, b"x" * 4096)
    os.set_blocking(writing, True)
    yield reading, writing
    os.close(reading)
    os.close(writing)


def port_of(endpoint: str) -> str:
    return endpoint.rpartition(":")[2]


def answers(address: str) -> bool:
    try:
        with urllib.request.urlopen(address, timeout=5) as answer:
            return bool(answer.status == 200)
    except OSError:
        return False


def configured(folder: Path, **cameras: str) -> tuple[list[str], str, str]:
    """Return the options of a configuration, the bus's endpoint and the health endpoint."""
    endpoint, health = free_endpoint(), f"127.0.0.1:{port_of(free_endpoint())}"
    path = folder / "c.toml"
    tables = "".join(f'[cameras.{name}]\nsource = "{source}"\n' for name, source in cameras.items())
    path.write_text(
        f'[bus]\nlisten = ["{endpoint}"]\nconnect_seconds = 0.5\n[state]\ndirectory = "{folder}/state"\n'
        f'[health]\nlisten = "{health}"\n{tables}',
        "utf-8",
    )
    return ["--config", str(path)], endpoint, f"http://{health}/healthz"


@contextlib.contextmanager
def running(process: subprocess.Popen[bytes]) -> Iterator[subprocess.Popen[bytes]]:
    """Run a program that has ended by the end of the block."""
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def ended(process: subprocess.Popen[bytes]) -> int:
    """End a program with SIGTERM and return its status."""
    process.terminate()
    return process.wait(END_SECONDS)


# --- standard error is a full pipe ---------------------------------------------------------------


def test_the_daemon_runs_and_ends_though_its_log_is_not_read(
    full: tuple[int, int], tmp_path: Path
) -> None:
    options, endpoint, health = configured(tmp_path)
    with running(serving.camtopod(*options, "run", stderr=full[1])) as process:
        wait_for(lambda: answers(health), "the daemon's health")
        with contextlib.closing(buses.dial(small_config(tmp_path, endpoint))) as bus:
            wait_for(lambda: bool(bus.query("status/daemon", one=True)), "an answer")
            for number in range(3):  # each is said in the log
                bus.publish_raw(f"event/cam{number}", b"\xc1" * (number + 1), "event")
            wait_for(lambda: bool(bus.query("status/daemon", one=True)), "an answer")
        assert answers(health), "it has lost nothing but lines of its log"
        assert ended(process) == 0


@pytest.mark.parametrize("how", ["one", "all", "web"])
def test_so_do_a_grabber_and_the_page(how: str, full: tuple[int, int], tmp_path: Path) -> None:
    options, endpoint, _ = configured(tmp_path, lobby="rtsp://127.0.0.1:1/x")
    commands = {
        "one": [*options, "grab", "--camera", "lobby"],
        "all": [*options, "grab"],
        "web": ["--connect", endpoint, "web", "--listen", f"127.0.0.1:{port_of(free_endpoint())}"],
    }
    config = msgspec.structs.replace(small_config(tmp_path), bus=BusSettings(listen=(endpoint,)))
    with (
        contextlib.closing(buses.open_daemon_session(config)) as bus,
        running(serving.camtopod(*commands[how], stderr=full[1])) as process,
    ):
        if how == "web":
            wait_for(lambda: answers(f"http://{commands[how][-1]}/"), "the page")
        else:
            wait_for(lambda: bool(bus.query("status/lobby", one=True)), "the camera's status")
        assert ended(process) == 0


def test_what_is_missing_is_said_when_somebody_reads_again(full: tuple[int, int]) -> None:
    stream = NonBlockingStream(full[1], characters_max=100)
    for number in range(100):
        print(f"message {number}", file=stream)
    assert not stream.settle(0.05)
    text = b""

    def read() -> None:
        nonlocal text
        while b"the end" not in text:
            text += os.read(full[0], 65536)

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    wait_for(lambda: stream.settle(0.1), "what waits to be written")
    print("the end", file=stream)
    reader.join(10)
    said = text.decode().lstrip("x").splitlines()
    assert said[:2] == ["message 0", "message 1"]
    assert "messages are missing here" in said[-2]
    assert said[-1] == "the end"
    assert len(said) < 20


def test_what_was_said_is_written_before_the_end(tmp_path: Path) -> None:
    options, _, _ = configured(tmp_path)
    process = serving.camtopod(*options, "--log-format", "json", "watch", stderr=subprocess.PIPE)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 69
    assert "cannot reach the bus" in json.loads(said.splitlines()[-1])["message"]


# --- closed --------------------------------------------------------------------------------------


def with_closed(closed: str, *arguments: str, **popen: Any) -> subprocess.Popen[bytes]:
    """Start the program by a shell with ``closed``, for example ``2>&-``."""
    line = ["sh", "-c", f'exec "$0" -m camtopod "$@" {closed}', sys.executable, *arguments]
    return subprocess.Popen(line, env={**os.environ, "PYTHONPATH": str(ROOT)}, **popen)


@pytest.mark.parametrize("closed", ["2>&-", ">&-", "<&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_the_daemon_runs_with_closed_streams(closed: str, tmp_path: Path) -> None:
    options, endpoint, health = configured(tmp_path)
    with running(with_closed(closed, *options, "run")) as process:
        wait_for(lambda: process.poll() is not None or answers(health), "the daemon's health")
        assert process.poll() is None
        numbers = [os.readlink(f"/proc/{process.pid}/fd/{number}") for number in range(3)]
        assert not [name for name in numbers if name.startswith(str(tmp_path))], (
            "no file has a stream's number"
        )
        with contextlib.closing(buses.dial(small_config(tmp_path, endpoint))) as bus:
            wait_for(lambda: bool(bus.query("status/daemon", one=True)), "an answer")
        assert ended(process) == 0


def test_data_that_cannot_be_written_is_no_success(tmp_path: Path) -> None:
    (tmp_path / "e.jsonl").write_text('{"camera":"a","kind":"exit","t":1.0}\n', "utf-8")
    arguments = ["learn", str(tmp_path / "e.jsonl")]
    for closed, status in (("2>&-", 0), (">&-", 1), (">&- 2>&-", 1)):
        process = with_closed(closed, *arguments, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        _, said = process.communicate(timeout=60)
        assert process.returncode == status, closed
        assert b"Traceback" not in said
    process = with_closed(">&-", *arguments, stderr=subprocess.PIPE)
    assert b"standard input or output is closed" in process.communicate(timeout=60)[1]


# --- few files -----------------------------------------------------------------------------------


def test_with_too_few_files_it_says_so_and_ends(tmp_path: Path) -> None:
    options, _, _ = configured(tmp_path)
    for command in (
        ["run"],
        ["grab", "--camera", "lobby", "rtsp://127.0.0.1:1/x"],
        ["web", "--listen", "[::1]:0"],
    ):
        line = [
            "sh",
            "-c",
            'ulimit -n 32 && exec "$0" -m camtopod "$@"',
            sys.executable,
            *options,
            *command,
        ]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            line, env=environment, capture_output=True, text=True, check=False, timeout=60
        )
        assert done.returncode == 1
        assert (
            "this process may have 32 files open at a time, but needs 64"
            in done.stderr.splitlines()[-1]
        )
        assert "panic" not in done.stderr


def test_it_takes_as_many_as_it_may_have(tmp_path: Path) -> None:
    options, _, health = configured(tmp_path)
    line = [
        "sh",
        "-c",
        'ulimit -Sn 40 && exec "$0" -m camtopod "$@"',
        sys.executable,
        *options,
        "run",
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with running(subprocess.Popen(line, env=environment)) as process:
        wait_for(lambda: answers(health), "the daemon's health")
        soft, hard = resource.prlimit(process.pid, resource.RLIMIT_NOFILE)
        assert soft == min(hard, 65_536)
        assert ended(process) == 0
