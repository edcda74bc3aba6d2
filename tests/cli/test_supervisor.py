"""The supervisor of many cameras, a process each: deaths, hangs, shutdown, new configurations."""

from __future__ import annotations

import argparse
import ctypes
import itertools
import logging
import os
import re
import signal
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
from serving import WAIT_SECONDS, small_config, wait_for

from camtopod.cli.cameras import supervisor
from camtopod.cli.cameras.camera_process import (
    CameraProcess,
    backoff_after,
    exit_reason,
    with_restarts,
)
from camtopod.cli.cameras.heartbeat import Heartbeat, HeartbeatReceiver, HeartbeatSender
from camtopod.cli.common import SignalRequests, ends_within, signals
from camtopod.cli.exits import CommandError
from camtopod.config import settings as configs
from camtopod.config.settings import CameraSettings, HealthSettings
from camtopod.serve.bus import session as buses

CHILD = """
import os, pathlib, signal, sys, time
camera, restarts, fd, folder = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), pathlib.Path(sys.argv[4])
trace = (folder / camera).open("a", buffering=1)
print("start", os.getpid(), restarts, time.monotonic(), file=trace)
def beat(state="running"):
    print("beat", time.monotonic(), file=trace)
    os.write(fd, b'{"state":"' + state.encode() + b'","reason":""}' + bytes([10]))
kind = camera.split("-")[0]
if kind == "crashes": sys.exit(1)
if kind == "hopeless": sys.exit(78)
if kind == "blocked": time.sleep(1000)
if kind == "ends": beat("ended"); sys.exit(0)
if kind == "leaves": beat(); sys.exit(0)
if kind == "deaf": signal.signal(signal.SIGTERM, signal.SIG_IGN)
else: signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
for turn in range(100000):
    if kind == "hangs" and turn == 5: time.sleep(1000)
    if kind == "recovers" and turn == 5 and restarts < 2: os._exit(3)
    beat()
    time.sleep(0.02)
"""
QUICK = "[health]\nhung_seconds = 0.6\nstart_seconds = 1.2\nrestart_seconds_min = 0.05\nrestart_seconds_max = 0.4\n"


class Box:
    """A supervisor in a thread; its processes behave as their camera's name says."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self.file = folder, folder / "c.toml"
        self.told = SignalRequests(threading.Event(), threading.Event())
        self.args = argparse.Namespace(
            config=self.file,
            site=None,
            connect=[],
            log_format="json",
            state=None,
            start=None,
            speed=None,
            realtime=None,
        )
        self.head = f'{QUICK}[bus]\nconnect = ["tcp/127.0.0.1:1"]\nconnect_seconds = 0.1\n[limits]\nstatus_seconds = 0.1\n'
        self.statuses: list[int] = []
        self._thread: threading.Thread | None = None
        monkeypatch.setattr(
            supervisor,
            "command",
            lambda camera, args, config_fd, restarts, last_end, fd: [
                sys.executable,
                "-c",
                CHILD,
                camera,
                str(restarts),
                str(fd),
                str(folder),
            ],
        )

    def configure(self, *cameras: str, **sources: str) -> None:
        tables = [
            f'[cameras.{name}]\nsource = "{sources.get(name, "rtsp://h/x")}"\n' for name in cameras
        ]
        self.file.write_text(self.head + "".join(tables))

    def start(self) -> None:
        text = self.file.read_bytes()
        config = configs.load(self.file)
        self._thread = threading.Thread(
            target=lambda: self.statuses.append(
                supervisor.supervise(self.args, config, text, self.told)
            )
        )
        self._thread.start()

    def said(self, camera: str) -> list[list[str]]:
        path = self.folder / camera
        return [line.split() for line in path.read_text().splitlines()] if path.exists() else []

    def starts(self, camera: str) -> int:
        return sum(words[0] == "start" for words in self.said(camera))

    def pid(self, camera: str) -> int:
        return int([words for words in self.said(camera) if words[0] == "start"][-1][1])

    def beats(self, camera: str) -> list[float]:
        return [
            float(words[1]) for words in self.said(camera) if words[0] == "beat" and len(words) == 2
        ]

    def stop(self) -> int:
        self.told.stop.set()
        assert self._thread is not None
        self._thread.join(WAIT_SECONDS)
        return self.statuses[0]


@pytest.fixture
def box(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Box]:
    one = Box(tmp_path, monkeypatch)
    yield one
    if one._thread is not None:
        one.stop()


def with_path() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT)}


def there(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_one_that_dies_hangs_or_blocks_is_started_again_and_delays_nobody(
    box: Box, caplog: pytest.LogCaptureFixture
) -> None:
    bad = ("crashes", "hangs", "blocked", "leaves")
    box.configure("blocked", "crashes", "good", "good-2", "hangs", "leaves")
    with caplog.at_level(logging.INFO):
        box.start()
        wait_for(
            lambda: all(box.starts(camera) >= 3 for camera in bad),
            "three starts of each that fails",
        )
        began = time.monotonic()
        assert box.stop() == 0
        assert time.monotonic() - began < 3.0
    for camera in ("good", "good-2"):
        beats = box.beats(camera)
        assert box.starts(camera) == 1
        assert max(b - a for a, b in itertools.pairwise(beats)) < 0.5, "a bad camera held it up"
    for camera, why in (
        ("hangs", "hung for 1 s while running"),
        ("blocked", "while connecting"),
        ("crashes", "failed"),
    ):
        assert any(camera in text and why in text for text in caplog.messages), (
            camera,
            caplog.messages,
        )
        assert not there(box.pid(camera))
    assert any("leaves: ended by itself" in text for text in caplog.messages)


def test_without_the_watch_a_hanging_one_would_stay(box: Box) -> None:
    """Check of the harness: the same camera under a limit that is never reached."""
    box.head = box.head.replace("hung_seconds = 0.6", "hung_seconds = 1000")
    box.configure("hangs", "crashes")
    box.start()
    wait_for(lambda: box.starts("crashes") >= 4, "some time to pass")
    wait_for(lambda: len(box.beats("hangs")) == 5, "it to hang")
    assert box.starts("hangs") == 1


def test_the_worst_status_when_all_have_ended(box: Box) -> None:
    box.configure("ends", "hopeless", "ends-2")
    box.start()
    wait_for(lambda: bool(box.statuses), "the end")
    assert box.statuses == [78]
    assert {camera: box.starts(camera) for camera in ("ends", "hopeless", "ends-2")} == {
        "ends": 1,
        "hopeless": 1,
        "ends-2": 1,
    }


def test_a_file_that_was_begun_is_not_begun_again(
    box: Box, caplog: pytest.LogCaptureFixture
) -> None:
    """Its events would be duplicated, with new numbers."""
    files = ("recovers", "hangs", "crashes")
    box.configure(*files, "hangs-live", **dict.fromkeys(files, "film.mp4"))
    with caplog.at_level(logging.INFO):
        box.start()
        wait_for(lambda: box.starts("hangs-live") >= 3, "a stream to be started again and again")
        wait_for(
            lambda: box.starts("crashes") >= 3, "a file that never got to its first frame, too"
        )
        wait_for(
            lambda: not there(box.pid("recovers")) and not there(box.pid("hangs")),
            "both to have ended",
        )
    assert box.stop() == 0
    assert (box.starts("recovers"), box.starts("hangs")) == (1, 1)
    for camera, why in (
        ("recovers", r"failed \(status 3\)"),
        ("hangs", "hung for 1 s while running"),
    ):
        said = re.compile(
            rf"camera {camera}: {why}; not restarted, as the events of a file would count twice"
        )
        assert any(said.search(text) for text in caplog.messages), caplog.messages


def test_a_signal_s_number_is_no_exit_status(box: Box) -> None:
    box.configure("good", good="film.mp4")
    box.start()
    wait_for(lambda: bool(box.beats("good")), "it to run")
    os.kill(box.pid("good"), signal.SIGKILL)
    wait_for(lambda: bool(box.statuses), "the end")
    assert box.statuses == [1]


def test_one_that_will_not_end_is_killed(box: Box, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("camtopod.cli.cameras.camera_process.STOP_SECONDS", 0.3)
    box.configure("deaf", "good")
    box.start()
    wait_for(lambda: bool(box.beats("deaf")) and bool(box.beats("good")), "both")
    began = time.monotonic()
    assert box.stop() == 0
    assert time.monotonic() - began < 2.0
    assert not there(box.pid("deaf"))


def test_a_stopped_process_is_found_and_killed(box: Box) -> None:
    box.configure("good")
    box.start()
    wait_for(lambda: bool(box.beats("good")), "it to run")
    os.kill(box.pid("good"), signal.SIGSTOP)
    wait_for(lambda: box.starts("good") == 2, "a second process")


def test_another_configuration_touches_only_what_changed(
    box: Box, caplog: pytest.LogCaptureFixture
) -> None:
    box.configure("good-same", "good-changed", "good-gone")
    box.start()
    wait_for(
        lambda: all(box.beats(f"good-{name}") for name in ("same", "changed", "gone")), "all three"
    )
    same, gone = box.pid("good-same"), box.pid("good-gone")
    box.configure("good-same", "good-changed", "good-new", **{"good-changed": "rtsp://other/x"})
    with caplog.at_level(logging.INFO):
        box.told.reload.set()
        wait_for(
            lambda: bool(box.beats("good-new")) and box.starts("good-changed") == 2, "the new ones"
        )
    wait_for(lambda: not there(gone), "the end of what is gone")
    assert "started: good-new; restarted: good-changed; ended: good-gone" in caplog.text
    assert (box.starts("good-same"), box.pid("good-same"), there(same)) == (1, same, True)

    caplog.clear()
    box.file.write_text('[cameras.lobby]\nsorce = "rtsp://u:p@ssword@h/x"\n')
    box.told.reload.set()
    wait_for(lambda: "the old configuration stays" in caplog.text, "the report")
    assert "no such key" in caplog.text
    assert "p@ssword" not in caplog.text
    count = len(box.beats("good-same"))
    wait_for(lambda: len(box.beats("good-same")) > count + 3, "the old ones to go on")
    assert (box.starts("good-new"), box.starts("good-same")) == (1, 1)

    box.configure(
        "good-gone", "good-same", "good-new", "good-changed", **{"good-changed": "rtsp://other/x"}
    )
    box.told.reload.set()
    wait_for(lambda: box.starts("good-gone") == 2, "it to come back")
    assert (box.starts("good-same"), box.starts("good-changed")) == (1, 2)


def test_a_setting_of_one_camera_starts_that_one_anew(
    box: Box, caplog: pytest.LogCaptureFixture
) -> None:
    """Also a setting of all, where a camera has its own."""
    cameras = ("good", "good-2")

    def write(vision: str, own: str) -> None:
        box.configure(*cameras)
        with box.file.open("a") as file:  # the last table is that of good-2
            file.write(f"{own}\n[vision]\n{vision}\n")

    def starts() -> tuple[int, int]:
        return box.starts("good"), box.starts("good-2")

    write("", "")
    box.start()
    wait_for(lambda: all(box.beats(camera) for camera in cameras), "both")
    with caplog.at_level(logging.INFO):
        for vision, own, expected in (
            ("", "analysed_fps = 5\nignore = ['0,0,1,0,1,0.1']", (1, 2)),
            ("analysed_fps = 6", "analysed_fps = 5\nignore = ['0,0,1,0,1,0.1']", (2, 2)),
            ("analysed_fps = 6", "analysed_fps = 5", (2, 3)),
        ):
            write(vision, own)
            box.told.reload.set()
            wait_for(lambda expected=expected: starts() == expected, f"{expected} starts")
    told = [text for text in caplog.messages if "is reloaded" in text]
    assert [text.partition("restarted: ")[2] for text in told] == [
        f"{camera}; ended: none" for camera in ("good-2", "good", "good-2")
    ]


def test_cameras_without_a_source_cannot_be_run(box: Box, caplog: pytest.LogCaptureFixture) -> None:
    box.configure("good")
    box.start()
    wait_for(lambda: bool(box.beats("good")), "it to run")
    with box.file.open("a") as file:
        file.write("[cameras.bare]\nmin_height = 0.1\n")
    line = box.file.read_text().splitlines().index("[cameras.bare]") + 1
    box.told.reload.set()
    wait_for(lambda: "the old configuration stays" in caplog.text, "the report")
    assert f"{box.file}:{line}: cameras.bare: source is missing" in caplog.text
    assert box.starts("good") == 1
    with pytest.raises(CommandError, match=f":{line}: cameras.bare: source is missing"):
        supervisor.supervise(box.args, configs.load(box.file), box.file.read_bytes(), box.told)


def test_a_setting_of_all_starts_all_anew(box: Box) -> None:
    box.configure("good", "good-2")
    box.start()
    wait_for(lambda: bool(box.beats("good")) and bool(box.beats("good-2")), "both")
    box.head = box.head.replace("status_seconds = 0.1", "status_seconds = 0.2")
    box.configure("good", "good-2")
    box.told.reload.set()
    wait_for(lambda: box.starts("good") == box.starts("good-2") == 2, "both anew")


def test_an_operator_sees_how_often_and_why(box: Box, tmp_path: Path) -> None:
    """The status is published for a camera whose own process cannot do so."""
    meeting = buses.open_daemon_session(small_config(tmp_path))
    said: list[dict[str, Any]] = []
    meeting.subscribe("status/*", lambda key, raw: said.append(msgspec.msgpack.decode(raw)))
    box.head = box.head.replace("tcp/127.0.0.1:1", meeting.endpoint).replace("max = 0.4", "max = 4")
    box.configure("crashes", "good", "hopeless")
    with box.file.open("a") as file:
        file.write('[cameras.crashes-2]\nsource_file = "nowhere"\n')
    box.start()
    wait_for(
        lambda: any(s["camera"] == "crashes" and s["restarts"] >= 2 for s in said), "the restarts"
    )
    wait_for(
        lambda: any(s["camera"] == "crashes-2" for s in said), "one whose source cannot be read"
    )
    wait_for(lambda: any(s["state"] == "failed" for s in said), "the hopeless one")
    status = next(s for s in said if s["restarts"] >= 2)
    assert f"restarted {status['restarts']} times, last: failed (status 1)" in status["reason"]
    assert status["state"] in ("restarting", "connecting")
    failed = next(s for s in said if s["state"] == "failed")
    assert failed["reason"] == "refused the configuration (status 78); it is not restarted"
    answers = [msgspec.msgpack.decode(raw) for _, raw in meeting.query("status/hopeless")]
    assert [answer["state"] for answer in answers] == ["failed"]
    assert not any(s["camera"] == "good" for s in said), "it speaks for itself"
    assert box.stop() == 0
    meeting.close()


# --- the parts ------------------------------------------------------------------------------------


def test_a_camera_s_command_line_has_no_source_in_it() -> None:
    args = argparse.Namespace(
        config=Path("c.toml"),
        site="hq",
        connect=["tcp/h:1"],
        log_format="json",
        state="/s",
        start=None,
        speed=2.0,
        realtime=True,
    )
    text = " ".join(supervisor.command("lobby", args, 7, 3, "hung for 30 s", 9))
    assert (
        "--config c.toml --log-format json --site hq --connect tcp/h:1 grab --camera lobby" in text
    )
    assert "--config-fd 7 --beat-fd 9 --restarts 3 --last-end hung for 30 s" in text
    assert text.endswith("--state /s --speed 2.0 --realtime")
    assert "--restarts" not in supervisor.command("lobby", args, 7, 0, "", 9)


def test_backoff_grows_has_jitter_and_starts_anew_after_a_steady_run() -> None:
    health = HealthSettings()
    waits, backoff = [], health.restart_seconds_min
    for _ in range(10):
        wait, backoff = backoff_after(backoff, 0.5, health, chance=lambda: 0.5)
        waits.append(wait)
    assert waits == [1, 2, 4, 8, 16, 32, 60, 60, 60, 60]
    assert backoff_after(60.0, 61.0, health, chance=lambda: 0.0) == (0.5, 2.0)
    assert backoff_after(8.0, 1.0, health, chance=lambda: 1.0)[0] == 12.0


def test_words() -> None:
    assert exit_reason(74) == "cannot write its state directory (status 74)"
    assert (exit_reason(-9), exit_reason(-100)) == ("killed by SIGKILL", "killed by signal 100")
    assert with_restarts(0, "", "stalled") == "stalled"
    assert with_restarts(1, "failed", "") == "restarted once, last: failed"
    assert (
        with_restarts(3, "hung for 30 s", "no frame")
        == "no frame; restarted 3 times, last: hung for 30 s"
    )


def test_a_process_that_cannot_be_started_is_tried_again(caplog: pytest.LogCaptureFixture) -> None:
    child = CameraProcess("lobby", CameraSettings("rtsp://h/x"), HealthSettings())
    fd = os.open(os.devnull, os.O_RDONLY)
    child.look_after(100.0, lambda *_: ["/nowhere/at/all"], fd)
    os.close(fd)
    assert (child.state, child.restarts) == ("restarting", 1)
    assert "cannot be started" in child.summary(100.0)["reason"]
    assert child.again_at is not None
    assert 100.0 < child.again_at < 102.0


def test_a_start_that_takes_too_long_gets_more_time_the_next_time() -> None:
    """Otherwise a box too small for its cameras would kill them for ever while they load."""
    health = HealthSettings(start_seconds=10.0, hung_seconds=5.0, restart_seconds_min=1.0)
    child = CameraProcess("lobby", CameraSettings("rtsp://h/x"), health)
    fd, now, allowed = os.open(os.devnull, os.O_RDONLY), 100.0, []
    sleeping = [sys.executable, "-c", "import time; time.sleep(1000)"]
    for _ in range(3):
        while child.process is None:
            child.look_after(now, lambda *_: sleeping, fd)
            now += 0.5
        began = now - 0.5
        while not child._hung:
            child.look_after(now, lambda *_: sleeping, fd)
            now += 0.5
        allowed.append(now - began)
        while child.process is not None:
            child.look_after(now, lambda *_: sleeping, fd)
            time.sleep(0.01)
    os.close(fd)
    assert allowed == [pytest.approx(10 * 2**n, abs=1.5) for n in range(3)]


def test_silence_counts_only_while_somebody_listens() -> None:
    """A pause of the whole machine does not kill every camera."""
    child = CameraProcess("lobby", CameraSettings("rtsp://h/x"), HealthSettings(start_seconds=10.0))
    fd = os.open(os.devnull, os.O_RDONLY)
    sleeping = [sys.executable, "-c", "import time; time.sleep(1000)"]
    hung = []
    for now in (100.0, 101.0, *(5000.0 + second for second in range(15))):
        if not child._hung:
            child.look_after(now, lambda *_: sleeping, fd)
            hung.append(now)
    process = child.process
    assert process is not None
    process.kill()
    process.wait()
    child.look_after(6000.0, lambda *_: sleeping, fd)
    os.close(fd)
    assert hung[-1] == 5011.0, "eleven seconds after somebody listened again"


def test_heartbeats() -> None:
    ear = HeartbeatReceiver()
    heart = HeartbeatSender(ear.child_fd)
    assert ear.listen() is None
    heart.beat("running", "")
    assert ear.listen() == Heartbeat("running", "")
    heart.beat("running", "")
    assert ear.listen() is None, "not at every turn"
    heart.beat("stalled", "rtsp://admin:p@ss@h/x is slow " + "x" * 1000)
    said = ear.listen()
    assert said is not None
    assert said.state == "stalled"
    assert "p@ss" not in said.reason
    assert len(said.reason) <= 300
    os.set_blocking(ear.child_fd, False)
    os.write(ear.child_fd, b'garbage\n\xff\xfe\n{"state":1}\n')
    assert ear.listen() is None
    for number in range(10_000):  # nobody reads: it must not block
        heart.beat("running", str(number))
    assert ear.listen() is not None
    ear.close()
    heart.beat("ended", "")
    heart.beat("ended", "nobody is there")
    os.close(ear.child_fd)


# --- signals --------------------------------------------------------------------------------------


def test_signals_are_heard_even_if_the_main_thread_is_inside_a_library() -> None:
    """No Python handler runs while a C mutex is waited for; the events are set nevertheless."""
    before = signal.getsignal(signal.SIGHUP)
    library = ctypes.CDLL(None)
    mutex = ctypes.create_string_buffer(128)
    library.pthread_mutex_init(mutex, None)
    library.pthread_mutex_lock(mutex)
    heard = []
    with signals() as told:

        def release() -> None:
            os.kill(os.getpid(), signal.SIGHUP)
            heard.append(told.reload.wait(WAIT_SECONDS) and not told.stop.is_set())
            os.kill(os.getpid(), signal.SIGTERM)
            heard.append(told.stop.wait(WAIT_SECONDS))
            library.pthread_mutex_unlock(mutex)

        threading.Thread(target=release).start()
        library.pthread_mutex_lock(mutex)
        assert heard == [True, True]
    assert signal.getsignal(signal.SIGHUP) == before
    assert signal.set_wakeup_fd(-1) == -1


def test_many_signals_at_once_are_no_harm() -> None:
    with signals() as told:
        for _ in range(3000):
            os.kill(os.getpid(), signal.SIGHUP)
        assert told.reload.wait(WAIT_SECONDS)
        os.kill(os.getpid(), signal.SIGINT)
        assert told.stop.wait(WAIT_SECONDS)


LEAVES = """
import sys, threading
from camtopod.cli.common import ends_within, signals
with signals() as told, ends_within(told.stop, float(sys.argv[1])):
    print("ready", flush=True)
    lock = threading.Lock(); lock.acquire(); lock.acquire()
"""


def test_what_blocks_cannot_hold_up_the_end() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", LEAVES, "0.3"], stdout=subprocess.PIPE, env=with_path()
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"ready\n"
    process.send_signal(signal.SIGHUP)
    process.terminate()
    assert process.wait(WAIT_SECONDS) == 0
    process.stdout.close()


def test_without_that_it_would() -> None:
    """Check of the harness."""
    process = subprocess.Popen(
        [sys.executable, "-c", LEAVES, "1000"], stdout=subprocess.PIPE, env=with_path()
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"ready\n"
    process.terminate()
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(1.0)
    process.kill()
    process.wait()
    process.stdout.close()


def test_whoever_has_lost_its_parent_is_told_to_stop() -> None:
    stop = threading.Event()
    with ends_within(stop, 10.0, parent=os.getppid() + 1):  # ours is another
        assert stop.wait(WAIT_SECONDS)
    other = threading.Event()
    with ends_within(other, 10.0, parent=os.getppid()):
        assert not other.wait(0.7)


ENDS = """
import sys, threading
from camtopod.cli import main
threading.Thread(target=threading.Event().wait).start()
print("data")
sys.argv = ["camtopod", *sys.argv[1:]]
main.console()
"""


@pytest.mark.parametrize(
    ("arguments", "status"), [(["--version"], 0), (["nonsense"], 2), (["check", "/nowhere"], 66)]
)
def test_the_end_waits_for_no_thread(arguments: list[str], status: int) -> None:
    done = subprocess.run(
        [sys.executable, "-c", ENDS, *arguments],
        env=with_path(),
        capture_output=True,
        timeout=WAIT_SECONDS,
        check=False,
    )
    assert done.returncode == status
    assert done.stdout.startswith(b"data\n")
