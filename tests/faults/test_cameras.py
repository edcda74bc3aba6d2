"""Every kind of camera failure at once, under the real `camtopod grab`; one good camera goes on."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from paths import ROOT
from rendered_scenes import FPS, Person, Scene, line
from serving import WAIT_SECONDS, camtopod, small_config, wait_for

from bench.support.rtsp_streams import Host, hang_up, rtsp_answer, silent
from camtopod.codec import event_from_json
from camtopod.serve.daemon import Daemon
from camtopod.vision.grabber import Grabber
from camtopod.vision.source import live
from camtopod.vision.source.ffmpeg_log import reason_in

FILM_SECONDS = 12.0
SPEED = 3.0
QUICK = {
    "camtopod.cli.cameras.camera_process:HUNG_SECONDS": 3,
    "camtopod.cli.cameras.camera_process:RESTART_SECONDS_MIN": 0.5,
    "camtopod.cli.cameras.camera_process:RESTART_SECONDS_MAX": 4,
}


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a film in which a person walks through every three seconds."""
    people = [
        Person(line(3.5 + 3.0 * n, (-0.05, 0.7), (1.05, 0.65), 4.0), seed=n)
        for n in range(round(FILM_SECONDS / 3) - 2)
    ]
    return Scene(people).film(tmp_path_factory.mktemp("film") / "film.mp4", FILM_SECONDS)


@pytest.fixture
def hosts() -> Iterator[dict[str, Host]]:
    made = {
        "silent": Host(silent),
        "frozen": Host(silent),
        "flapping": Host(hang_up),
        "secret": Host(rtsp_answer("401 Unauthorized")),
    }
    yield made
    for host in made.values():
        host.close()


def children_of(pid: int) -> dict[str, int]:
    """Return camera and process id of each child of a supervisor."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError):
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                words = (entry / "cmdline").read_bytes().split(b"\0")
                if parent == pid and b"--camera" in words:
                    found[words[words.index(b"--camera") + 1].decode()] = int(entry.name)
    return found


def test_every_bad_camera_is_named_and_the_good_one_is_on_time(
    film: Path, hosts: dict[str, Host], tmp_path: Path
) -> None:
    expected = [
        e for e in Grabber("good", str(film), wall_clock=time.time).events() if e is not None
    ]
    assert len(expected) >= 4
    os.mkfifo(tmp_path / "fifo")  # opening it blocks for ever
    with socket.socket() as reserved:
        reserved.bind(("127.0.0.1", 0))  # bound, not listening: refuses
        sources = {
            "good": f'{film}"\nrealtime = true\n#"',
            "blocked": str(tmp_path / "fifo"),
            "missing": str(tmp_path / "nowhere.mp4"),
            "refused": f"rtsp://127.0.0.1:{reserved.getsockname()[1]}/x",
            **{name: host.url for name, host in hosts.items()},
        }
        with Daemon(small_config(tmp_path / "daemon")) as daemon:
            _watched(daemon, sources, expected_events=len(expected), directory=tmp_path)


def _watched(
    daemon: Daemon, sources: dict[str, str], expected_events: int, directory: Path
) -> None:
    said: dict[str, dict[str, Any]] = {}
    gaps: dict[str, float] = {}
    last: dict[str, float] = {}
    reasons: dict[str, set[str]] = {name: set() for name in sources}

    def on_status(key: str, raw: bytes) -> None:
        camera, now = key.removeprefix("status/"), time.monotonic()
        if camera in sources:
            status = msgspec.msgpack.decode(raw)
            if status["state"] != "ended":
                gaps[camera] = max(gaps.get(camera, 0.0), now - last.get(camera, now))
            said[camera], last[camera] = status, now
            reasons[camera].add(status["reason"])

    assert daemon._bus is not None
    daemon._bus.subscribe("status/*", on_status)
    config = directory / "c.toml"
    config.write_text(
        f'[bus]\nconnect = ["{daemon.endpoint}"]\n[state]\ndirectory = "{directory}/state"\n'
        "[limits]\nstatus_seconds = 0.2\n"
        + "".join(f'[cameras.{name}]\nsource = "{source}"\n' for name, source in sources.items())
    )
    config.chmod(0o600)
    with (directory / "log").open("wb") as log:
        box = camtopod(
            "--config", str(config), "grab", "--speed", str(SPEED), constants=QUICK, stderr=log
        )
    try:

        def told(camera: str, what: str) -> bool:
            return any(what in reason for reason in reasons[camera])

        wait_for(lambda: said.get("good", {}).get("state") == "running", "the good one to run")
        began = time.monotonic() - said["good"]["frames_grabbed"] / FPS / SPEED
        wait_for(lambda: said["good"]["state"] == "ended", "the good one's end")
        assert time.monotonic() - began < FILM_SECONDS / SPEED + 3.0, "it was held up"
        assert gaps["good"] < 1.5, "it was held up"
        assert said["good"]["restarts"] == 0
        wait_for(lambda: said.get("frozen", {}).get("failures", 0) >= 1, "the frozen one to run")
        os.kill(children_of(box.pid)["frozen"], signal.SIGSTOP)
        for camera, what in (
            ("refused", "nothing listens at this address and port"),
            ("secret", "the camera refuses the user name or password (401)"),
            ("silent", "the source cannot be opened"),
            ("flapping", "the source cannot be opened"),
            ("missing", "last: cannot read its source (status 66)"),
        ):
            wait_for(lambda camera=camera, what=what: told(camera, what), camera)  # type: ignore[misc]
        wait_for(lambda: said["silent"]["failures"] >= 2, "another try")
        wait_for(lambda: daemon.status().events["stored"] == expected_events, "all of its events")
        wait_for(lambda: told("frozen", "hung for 3 s while connecting"), "frozen")
        hung = "restarted 1 time, last: hung for 3 s while connecting"
        wait_for(lambda: told("blocked", hung), "blocked")
        wait_for(lambda: said["frozen"]["state"] == "connecting", "its return")
        assert said["frozen"]["restarts"] == 1
        assert "p@ss" not in str(reasons) + (directory / "log").read_text()

        children: dict[str, int] = {}

        def all_run() -> bool:
            children.clear()
            children.update(children_of(box.pid))
            return children.keys() >= sources.keys() - {"good", "missing"}

        wait_for(all_run, "a moment in which none of them is about to be started again")
        began = time.monotonic()
        box.terminate()
        assert box.wait(WAIT_SECONDS) == 0
        assert time.monotonic() - began < 9.0, "systemd would have killed it"
        assert not [pid for pid in children.values() if Path(f"/proc/{pid}").exists()], (
            "somebody was left behind"
        )
    finally:
        box.kill()
        box.wait()


def test_a_call_of_opencv_that_takes_too_long_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    go = threading.Event()

    class Blocked:
        is_open = False

        def __init__(self, *given: object) -> None:
            assert go.wait(WAIT_SECONDS)

        def release(self) -> None:
            pass

    monkeypatch.setattr(live, "Capture", Blocked)
    monkeypatch.setattr(live, "MARGIN_SECONDS", 0.1)
    monkeypatch.setattr(live, "OPEN_SECONDS_MAX", 0.1)
    monkeypatch.setattr(live, "READ_SECONDS_MAX", 0.1)
    grabber = Grabber("cam", "rtsp://127.0.0.1:1/x", wall_clock=time.time)
    stream = grabber.events()
    assert grabber.overdue_seconds == 0.0
    wait_for(lambda: next(stream) is None and grabber.overdue_seconds > 0.0, "it to be overdue")
    go.set()
    wait_for(lambda: next(stream) is None and grabber.overdue_seconds == 0.0, "it to come back")
    assert grabber.statistics()["failures"] >= 1
    grabber.close()


def test_lines_to_standard_output_say_what_is_wrong_with_the_camera(
    hosts: dict[str, Host], tmp_path: Path
) -> None:
    said = "the camera refuses the user name or password (401)"
    spoken = []
    for out in (["--out", "-"], ["--connect", "tcp/127.0.0.1:1", "--state", str(tmp_path)]):
        log = tmp_path / out[0]
        with log.open("wb") as file:
            line = ["grab", "--camera", "lobby", hosts["secret"].url, *out]
            process = camtopod(*line, stdout=subprocess.PIPE, stderr=file)
        try:
            wait_for(lambda log=log: said in log.read_text(), "the reason")  # type: ignore[misc]
            process.terminate()
            data, _ = process.communicate(timeout=WAIT_SECONDS)
        finally:
            process.kill()
        lines = [line.partition("; trying")[0] for line in log.read_text().splitlines()]
        spoken.append([line for line in lines if line.startswith("camera lobby is ")])
        assert data == b""
        assert process.returncode == (66 if out[0] == "--out" else 0)
        assert ("error: camera lobby gave no picture" in log.read_text()) == (out[0] == "--out")
        assert "p@ssw0rd" not in log.read_text()
    assert spoken[0] == spoken[1]


def test_a_good_camera_is_said_to_run_and_only_its_events_are_data(film: Path) -> None:
    out = subprocess.run(
        [sys.executable, "-m", "camtopod", "grab", "--camera", "good", str(film), "--out", "-"],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OPENCV_FFMPEG_LOGLEVEL": "56"},
    )

    assert "info: camera good is running\n" in out.stderr
    assert all(event_from_json(line).camera == "good" for line in out.stdout.splitlines())
    assert len(out.stdout.splitlines()) >= 4


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("method DESCRIBE failed: 401 (Unauthorized)", "the camera refuses the user name or"),
        ("Connection to tcp://a:p@ss@h:1 failed: Connection refused", "nothing listens at this"),
        ("method SETUP failed: 461 (Unsupported transport)", "the camera refuses (461)"),
        ("Failed to resolve hostname x: Name or service not known", "the host name cannot be"),
        ("rtsp://admin:p@ss@h: something new", ""),
    ],
)
def test_reasons_are_recognised_and_nothing_else_is_said(line: str, reason: str) -> None:
    said = reason_in(f"[OPENCV:FFMPEG:16] {line}\n".encode())

    assert said.startswith(reason)
    assert bool(said) == bool(reason)
    assert "p@ss" not in said
