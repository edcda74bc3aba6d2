"""The supervisor of many cameras, a process each: deaths, hangs, shutdown, new configurations."""

from __future__ import annotations

import argparse
import ctypes
import errno
import logging
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import msgspec
import pytest
from paths import ROOT
from serving import WAIT_SECONDS, small_config, wait_for

from camtopod.cli.cameras import camera_process, supervisor
from camtopod.cli.cameras.camera_process import CameraProcess
from camtopod.cli.common import SignalRequests, signals
from camtopod.cli.exits import CommandError
from camtopod.config import CameraSettings, config_file
from camtopod.serve import bus as buses

CHILD = """
import os, pathlib, signal, socket, sys, time
camera, folder = sys.argv[1], pathlib.Path(sys.argv[2])
out, address = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM), os.environ["NOTIFY_SOCKET"]
trace = (folder / camera).open("a", buffering=1)
print("start", os.getpid(), file=trace)
def beat(state="running"):
    print("beat", time.monotonic(), file=trace)
    out.sendto(b"STATUS=" + state.encode(), chr(0) + address[1:])
kind = camera.split("-")[0]
if kind == "crashes": sys.exit(1)
if kind == "hopeless": sys.exit(2)
if kind == "blocked": time.sleep(1000)
if kind == "ends": beat("ended"); sys.exit(0)
if kind == "leaves": beat(); sys.exit(0)
if kind == "deaf": signal.signal(signal.SIGTERM, signal.SIG_IGN)
else: signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
for turn in range(100000):
    if kind == "hangs" and turn == 5: time.sleep(1000)
    if kind == "fails" and turn == 5: os._exit(3)
    beat("blind" if kind == "fails" else "running")
    time.sleep(0.02)
"""
QUICK = {
    "HUNG_SECONDS": 4.0,
    "START_SECONDS": 5.0,
    "RESTART_SECONDS_MIN": 0.05,
    "RESTART_SECONDS_MAX": 0.4,
    "STOP_SECONDS": 0.3,
}


class Box:
    """A supervisor in a thread; its processes behave as their camera's name says."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder = folder
        self.file = folder / "c.toml"
        self.requests = SignalRequests(threading.Event(), threading.Event())
        self.args = options(self.file)
        self.head = '[bus]\nconnect = ["tcp/127.0.0.1:1"]\nconnect_seconds = 0.1\n[limits]\nstatus_seconds = 0.1\n'
        self.statuses: list[int] = []
        self._thread: threading.Thread | None = None
        child = [sys.executable, "-c", CHILD]
        monkeypatch.setattr(
            supervisor,
            "command",
            lambda process, args: [*child, process.camera, str(folder)],
        )
        for name, seconds in QUICK.items():
            monkeypatch.setattr(camera_process, name, seconds)

    def configure(self, *cameras: str, end: str = "", **sources: str) -> None:
        """Write the configuration; ``end``: its last lines."""
        tables = [
            f'[cameras.{name}]\nsource = "{sources.get(name, "rtsp://h/x")}"\n' for name in cameras
        ]
        self.file.write_text(self.head + "".join(tables) + end)

    def start(self) -> None:
        config = config_file.load(self.file)

        def run() -> None:
            self.statuses.append(supervisor.supervise(self.args, config, self.requests))

        self._thread = threading.Thread(target=run)
        self._thread.start()

    def reload(self) -> None:
        self.requests.reload.set()

    def trace(self, camera: str, word: str) -> list[str]:
        """Return what a camera's processes have written after ``word``, a line each."""
        path = self.folder / camera
        lines = path.read_text().splitlines() if path.exists() else []
        return [line.partition(" ")[2] for line in lines if line.startswith(f"{word} ")]

    def starts(self, camera: str) -> int:
        return len(self.trace(camera, "start"))

    def pid(self, camera: str) -> int:
        return int(self.trace(camera, "start")[-1])

    def beats(self, camera: str) -> list[float]:
        return [float(at) for at in self.trace(camera, "beat") if at]

    def wait_for_beats(self, *cameras: str) -> None:
        wait_for(lambda: all(self.beats(camera) for camera in cameras), "them to run")

    def stop(self) -> int:
        self.requests.stop.set()
        assert self._thread is not None
        self._thread.join(WAIT_SECONDS)
        return self.statuses[0]


def options(config: Path, **given: Any) -> argparse.Namespace:
    """Return the arguments of `camtopod grab`."""
    none = {"command": "grab", "site": None, "state": None, "start": 0.0, "realtime": False}
    return argparse.Namespace(
        **{**none, "config": config, "connect": [], "log_format": "json", **given}
    )


@pytest.fixture
def box(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Box]:
    box = Box(tmp_path, monkeypatch)
    yield box
    if box._thread is not None:
        box.stop()


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_camera_that_dies_or_hangs_is_restarted_and_delays_no_other(
    box: Box, caplog: pytest.LogCaptureFixture
) -> None:
    bad = ("crashes", "hangs", "blocked", "leaves")
    box.configure(*bad, "good", "good-stopped", "deaf")

    with caplog.at_level(logging.INFO):
        box.start()
        box.wait_for_beats("good-stopped")
        os.kill(box.pid("good-stopped"), signal.SIGSTOP)
        wait_for(lambda: all(box.starts(camera) >= 2 for camera in bad), "two starts of each")
        wait_for(lambda: box.starts("good-stopped") == 2, "a second process")
        box.wait_for_beats("deaf")
        assert box.stop() == 0

    assert box.starts("good") == 1
    log = "\n".join(caplog.messages)
    for text in (
        "camera hangs: the process hung for ([4-9]|[1-9][0-9]) s while running; killing it",
        "camera blocked: the process hung for ([4-9]|[1-9][0-9]) s while connecting; killing it",
        "camera crashes: ended with status 1; restarting in",
        "camera leaves: ended with status 0; restarting in",
    ):
        assert re.search(text, log)
    assert not any(is_running(box.pid(camera)) for camera in (*bad, "deaf", "good-stopped"))


def test_a_file_that_was_begun_is_not_begun_again(
    box: Box, caplog: pytest.LogCaptureFixture
) -> None:
    """Its events would be duplicated, with new numbers."""
    files = ("fails", "hangs", "crashes")
    box.configure(*files, **dict.fromkeys(files, "film.mp4"))
    box.start()
    wait_for(lambda: box.starts("crashes") >= 3, "one that never got to its first frame")
    wait_for(lambda: caplog.text.count("would count twice") == 2, "the others to end")
    assert box.stop() == 0
    assert (box.starts("fails"), box.starts("hangs")) == (1, 1)
    assert "camera fails: ended with status 3; not restarted, as the" in caplog.text


def test_another_configuration_touches_only_what_changed(
    box: Box, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("HUNG_SECONDS", "START_SECONDS"):
        monkeypatch.setattr(camera_process, name, WAIT_SECONDS)  # none hangs, on a busy machine
    caplog.set_level(logging.INFO)
    box.configure("good-same", "good-changed", "good-gone")
    box.start()
    box.wait_for_beats("good-same", "good-changed", "good-gone")
    gone = box.pid("good-gone")

    box.configure("good-same", "good-changed", "good-new", **{"good-changed": "rtsp://other/x"})
    box.reload()
    wait_for(lambda: box.starts("good-changed") == 2, "the new ones")
    box.wait_for_beats("good-new")
    wait_for(lambda: not is_running(gone), "the end of what is gone")

    # A setting of all cameras, of which good-new has its own; then one that none has.
    own = "analysed_fps = 5\n[vision]\nanalysed_fps = 6\n"
    box.configure("good-same", "good-changed", "good-new", end=own)
    box.reload()
    wait_for(lambda: box.starts("good-same") == box.starts("good-new") == 2, "both")
    wait_for(lambda: box.starts("good-changed") == 3, "the third")
    box.configure("good-same", "good-changed", "good-new", end=own.replace("6", "7"))
    box.reload()
    wait_for(lambda: box.starts("good-same") == 3, "one that follows")
    assert box.starts("good-new") == 2
    box.head = box.head.replace("status_seconds = 0.1", "status_seconds = 0.2")
    box.configure("good-same", "good-changed", "good-new", end=own.replace("6", "7"))
    box.reload()
    wait_for(lambda: box.starts("good-new") == 3, "all of them")


def test_a_wrong_configuration_changes_nothing(box: Box, caplog: pytest.LogCaptureFixture) -> None:
    box.configure("good")
    box.start()
    box.wait_for_beats("good")

    box.configure("good", end="[cameras.bare]\nmin_height = 0.1\n")
    line = box.file.read_text().splitlines().index("[cameras.bare]") + 1
    box.reload()
    missing = f"{box.file}:{line}: cameras.bare: source is missing"
    wait_for(lambda: missing in caplog.text, "the report")
    assert "the old configuration stays in use" in caplog.text
    count = len(box.beats("good"))
    wait_for(lambda: len(box.beats("good")) > count + 3, "it to go on")
    assert box.starts("good") == 1
    with pytest.raises(CommandError, match=re.escape(missing)):
        supervisor.supervise(box.args, config_file.load(box.file), box.requests)


def test_under_up_a_change_of_all_needs_a_restart(
    box: Box, caplog: pytest.LogCaptureFixture
) -> None:
    box.args = options(box.file, command="up")
    box.configure("good")
    box.start()
    box.wait_for_beats("good")

    for table, end in (
        ("[site]", '[site]\nname = "other"\n'),
        ("[state]", '[state]\ndirectory = "/nowhere"\n'),
    ):
        box.configure("good", "good-new", end=end)
        box.reload()
        words = f"the old configuration stays in use: a change of {table} needs a restart"
        wait_for(lambda words=words: words in caplog.text, words)  # type: ignore[misc]
    assert box.starts("good-new") == 0
    box.configure("good", "good-new", end='[health]\nlisten = "h:1"\n')
    box.reload()
    box.wait_for_beats("good-new")
    assert "a change of [health] needs a restart of `camtopod up`; the cameras go on" in caplog.text
    assert box.starts("good") == 1


def test_an_operator_sees_how_often_and_why(box: Box, tmp_path: Path) -> None:
    """The status is published for a camera whose own process cannot do so."""
    meeting = buses.open_daemon_session(small_config(tmp_path))
    statuses: list[dict[str, Any]] = []
    meeting.subscribe("status/*", lambda key, raw: statuses.append(msgspec.msgpack.decode(raw)))
    box.head = box.head.replace("tcp/127.0.0.1:1", meeting.endpoint).replace("max = 0.4", "max = 4")
    box.configure(
        "crashes", "good", "hopeless", end='[cameras.crashes-2]\nsource_file = "nowhere"\n'
    )

    box.start()
    wait_for(lambda: any(one["restarts"] >= 2 for one in statuses), "the restarts")
    wait_for(
        lambda: {"crashes", "crashes-2", "hopeless"} == {one["camera"] for one in statuses},
        "all but the good one, which speaks for itself",
    )
    again = next(one for one in statuses if one["restarts"] >= 2)
    assert f"restarted {again['restarts']} times, last: ended with status 1" in again["reason"]
    assert again["state"] in ("restarting", "connecting")
    failed = next(one for one in statuses if one["camera"] == "hopeless")
    assert failed["state"] == "failed"
    assert failed["reason"] == "ended with status 2; it is not restarted"
    assert all(one["status_seconds"] > 0.0 for one in statuses)
    assert box.stop() == 0
    meeting.close()


# --- the parts ------------------------------------------------------------------------------------


def test_a_camera_s_command_line_has_no_source_in_it() -> None:
    process = CameraProcess("lobby", CameraSettings(source="rtsp://h/x"))
    process.restarts = 3
    process.last_end = "hung for 30 s"
    given = options(Path("c.toml"), site="hq", connect=["tcp/h:1"], state="/s", realtime=True)

    text = " ".join(supervisor.command(process, given))

    assert "--config c.toml --log-format json --log-level info --site hq --connect tcp/h:1" in text
    assert text.endswith("--restarts 3 --last-end hung for 30 s --start 0.0 --state /s --realtime")


def test_backoff_grows_and_a_process_that_cannot_be_started_has_failed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    process = CameraProcess("lobby", CameraSettings(source="rtsp://h/x"))
    monkeypatch.setattr(camera_process.random, "random", lambda: 0.5)

    waits = []
    now = 100.0
    for _ in range(10):
        process.look_after(now, ["/nowhere/at/all"])
        assert process.start_at is not None
        waits.append(process.start_at - now)
        now = process.start_at

    assert waits == [1, 2, 4, 8, 16, 32, 60, 60, 60, 60]
    assert "cannot be started: No such file" in process.summary()["reason"]


def test_a_device_that_is_unplugged_is_started_again() -> None:
    process = CameraProcess("lobby", CameraSettings(source="/dev/v4l/by-id/usb-unplugged-index0"))
    process.state = "running"
    process._ended(-6, 100.0)
    assert process.state == "restarting"


def test_a_process_is_started_later_when_there_is_no_file_for_its_heartbeats(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail() -> NoReturn:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(camera_process, "HeartbeatReceiver", fail)
    process = CameraProcess("lobby", CameraSettings(source="rtsp://h/x"))

    process.look_after(100.0, ["/nowhere/at/all"])

    assert process.start_at is not None
    assert process.start_at > 100.0
    assert process.reason == "cannot be started: Too many open files"


# --- signals --------------------------------------------------------------------------------------


def test_signals_are_heard_even_if_the_main_thread_is_inside_a_library() -> None:
    """No Python handler runs while a C mutex is waited for; the events are set nevertheless."""
    before = signal.getsignal(signal.SIGHUP)
    library = ctypes.CDLL(None)
    mutex = ctypes.create_string_buffer(128)
    library.pthread_mutex_init(mutex, None)
    library.pthread_mutex_lock(mutex)
    heard = []
    with signals() as requests:

        def release() -> None:
            for _ in range(3000):
                os.kill(os.getpid(), signal.SIGHUP)
            heard.append(requests.reload.wait(WAIT_SECONDS) and not requests.stop.is_set())
            os.kill(os.getpid(), signal.SIGTERM)
            heard.append(requests.stop.wait(WAIT_SECONDS))
            library.pthread_mutex_unlock(mutex)

        threading.Thread(target=release).start()
        library.pthread_mutex_lock(mutex)
        assert heard == [True, True]
    assert signal.getsignal(signal.SIGHUP) == before
    assert signal.set_wakeup_fd(-1) == -1


LEAVES = """
import sys, threading
from camtopod.cli.common import ends_within, signals
with signals() as requests, ends_within(requests.stop, 0.3):
    print("ready", flush=True)
    lock = threading.Lock(); lock.acquire(); lock.acquire()
"""


def test_what_blocks_cannot_hold_up_the_end() -> None:
    process = subprocess.Popen([sys.executable, "-c", LEAVES], stdout=subprocess.PIPE, cwd=ROOT)
    assert process.stdout is not None
    assert process.stdout.readline() == b"ready\n"
    process.send_signal(signal.SIGHUP)
    process.terminate()
    assert process.wait(WAIT_SECONDS) == 0
    process.stdout.close()
