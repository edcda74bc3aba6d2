"""The real `camtopod grab`: every kind of camera failure at once, and kill -9 while events flow."""

from __future__ import annotations

import contextlib
import os
import random
import re
import signal
import socket
import sqlite3
import subprocess
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import pytest
from grabber import publisher_on
from rendered_scenes import FPS, Person, Scene, line
from serving import WAIT_SECONDS, camtopod, small_config, wait_for
from sizes import size

from bench.support.rtsp_streams import (
    Host,
    hang_up,
    missing,
    rtsp_answer,
    served,
    silent,
    transcode,
)
from bench.support.site import children
from camtopod.codec import event_from_json
from camtopod.config.settings import SiteSettings
from camtopod.serve.bus import dial
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox import spool_path
from camtopod.serve.storage.journal import Journal
from camtopod.vision.grabber import Grabber
from camtopod.vision.source import capture, live
from camtopod.vision.source.ffmpeg_log import reason_in

RESTARTS = {
    "camtopod.cli.cameras.camera_process:RESTART_SECONDS_MIN": 0.1,
    "camtopod.cli.cameras.camera_process:RESTART_SECONDS_MAX": 0.4,
}
"""Constants with which a camera's process is started again soon."""
HUNG = {"camtopod.cli.cameras.camera_process:HUNG_SECONDS": 10}
REFUSED = "the camera refuses the user name or password (401)"


class Box:
    """`camtopod grab` of all cameras, which are processes under a supervisor."""

    def __init__(
        self,
        directory: Path,
        endpoint: str,
        sources: Mapping[str, str],
        constants: Mapping[str, object] = RESTARTS,
    ) -> None:
        self.state = directory / "box"
        self._log = directory / "log"
        self._constants = constants
        self._config = directory / "box.toml"
        self._config.write_text(
            f'[bus]\nconnect = ["{endpoint}"]\n[state]\ndirectory = "{self.state}"\n'
            "[limits]\nstatus_seconds = 0.2\n"
            + "".join(f'[cameras.{name}]\nsource = "{value}"\n' for name, value in sources.items())
        )
        self._config.chmod(0o600)
        self.start()

    def start(self) -> None:
        command = ("--config", str(self._config), "grab")
        with self._log.open("ab") as log:
            self.process = camtopod(*command, constants=self._constants, stderr=log)

    @property
    def log(self) -> str:
        return self._log.read_text()

    @property
    def grabbers(self) -> dict[str, int]:
        """The process id of each camera's process that there is."""
        found = {}
        for child in children(self.process.pid):
            with contextlib.suppress(OSError):
                words = Path(f"/proc/{child}/cmdline").read_text().split("\0")
                if "--camera" in words:
                    found[words[words.index("--camera") + 1]] = child
        return found

    def close(self) -> None:
        """End it, with all of its processes."""
        left = self.grabbers
        self.process.terminate()
        try:
            assert self.process.wait(WAIT_SECONDS) == 0, self.log[-3000:]
        finally:
            self.process.kill()
            self.process.wait()
        assert not [pid for pid in left.values() if Path(f"/proc/{pid}").exists()], "left behind"


# --- failures -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a film of 9 seconds in which two people walk through."""
    people = [Person(line(t, (-0.05, 0.7), (1.05, 0.65), 4.0), seed=int(t)) for t in (2.5, 4.0)]
    return Scene(people).film(tmp_path_factory.mktemp("film") / "film.mp4", 9.0)


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


class Statuses:
    """The newest status of each camera on the bus, and all reasons that were given."""

    def __init__(self, daemon: Daemon) -> None:
        self.newest: dict[str, dict[str, Any]] = defaultdict(dict)
        self.reasons: dict[str, set[str]] = defaultdict(set)
        assert daemon._bus is not None
        daemon._bus.subscribe("status/*", self._on_status)

    def is_said(self, camera: str, what: str) -> bool:
        return any(re.search(what, reason) for reason in self.reasons[camera].copy())

    def _on_status(self, key: str, raw: bytes) -> None:
        camera, status = key.removeprefix("status/"), msgspec.msgpack.decode(raw)
        if camera != "daemon":
            self.newest[camera] = status
            self.reasons[camera].add(status["reason"])


def test_every_bad_camera_is_named_and_the_good_one_goes_on(
    film: Path, hosts: dict[str, Host], tmp_path: Path
) -> None:
    expected = list(filter(None, Grabber("good", str(film), wall_clock=time.time).events()))
    assert len(expected) >= 4
    with contextlib.ExitStack() as stack:
        refusing = stack.enter_context(socket.socket())
        refusing.bind(("127.0.0.1", 0))  # bound, not listening
        sources = {
            "good": f'{film}"\nrealtime = true\n#"',
            "missing": str(tmp_path / "nowhere.mp4"),
            "refused": f"rtsp://127.0.0.1:{refusing.getsockname()[1]}/x",
            **{name: host.url for name, host in hosts.items()},
        }
        daemon = stack.enter_context(Daemon(small_config(tmp_path / "daemon")))
        statuses = Statuses(daemon)
        newest = statuses.newest
        box = Box(tmp_path, daemon.endpoint, sources, constants=HUNG)
        stack.callback(box.close)

        wait_for(lambda: newest["frozen"].get("state") == "connecting", "the frozen one to run")
        os.kill(box.grabbers["frozen"], signal.SIGSTOP)
        wait_for(lambda: newest["good"].get("state") == "ended", "the good one's end", 60.0)
        assert newest["good"]["restarts"] == 0
        for camera, what in (
            ("refused", "nothing listens at this address and port"),
            ("secret", re.escape(REFUSED)),
            ("silent", "the source cannot be opened"),
            ("flapping", "the source cannot be opened"),
            ("missing", "last: ended with status 66"),
            ("frozen", r"restarted 1 time, last: hung for [1-9][0-9] s while connecting"),
        ):
            wait_for(lambda camera=camera, what=what: statuses.is_said(camera, what), camera)  # type: ignore[misc]
        wait_for(lambda: daemon.status().events.stored == len(expected), "all of its events")
        wait_for(lambda: newest["frozen"]["state"] == "connecting", "its return")
        assert "p@ss" not in str(statuses.reasons) + box.log


def test_a_call_of_opencv_that_takes_too_long_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    go = threading.Event()

    class Blocked:
        is_open = False

        def __init__(self, *given: object) -> None:
            assert go.wait(WAIT_SECONDS)

        def release(self) -> None:
            pass

    monkeypatch.setattr(live, "Capture", Blocked)
    monkeypatch.setattr(capture, "CALL_SECONDS_MAX", 0.1)
    grabber = Grabber("cam", "rtsp://127.0.0.1:1/x", wall_clock=time.time)
    stream = grabber.events()
    assert grabber.overdue_seconds == 0.0

    wait_for(lambda: next(stream) is None and grabber.overdue_seconds > 0.0, "it to be overdue")
    go.set()
    wait_for(lambda: next(stream) is None and grabber.overdue_seconds == 0.0, "it to come back")

    assert grabber.statistics()["failures"] >= 1
    grabber.close()


def test_a_camera_that_refuses_is_said_by_its_own_process(
    hosts: dict[str, Host], tmp_path: Path
) -> None:
    log = tmp_path / "log"
    command = ["grab", "--camera", "lobby", hosts["secret"].url, "--out", "-"]
    with log.open("wb") as file, camtopod(*command, stdout=subprocess.PIPE, stderr=file) as process:
        try:
            wait_for(lambda: REFUSED in log.read_text(), "the reason")
            process.terminate()
            data, _ = process.communicate(timeout=WAIT_SECONDS)
        finally:
            process.kill()

    assert data == b""
    assert process.returncode == 66
    assert "camtopod: camera lobby gave no picture" in log.read_text()
    assert "p@ssw0rd" not in log.read_text()


def test_a_good_camera_is_said_to_run_and_only_its_events_are_data(
    film: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENCV_FFMPEG_LOGLEVEL", "56")
    command = ("grab", "--camera", "good", str(film), "--out", "-")
    with camtopod(*command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        out, log = process.communicate(timeout=60)
    monkeypatch.undo()

    assert b"info: camera good is running\n" in log
    assert all(event_from_json(line).camera == "good" for line in out.splitlines())
    assert len(out.splitlines()) >= 4


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("method DESCRIBE failed: 401 (Unauthorized)", "the camera refuses the user name or"),
        ("Connection to tcp://a:p@ss@h:1 failed: Connection refused", "nothing listens at this"),
        ("method SETUP failed: 461 (Unsupported transport)", "the camera refuses TCP: for UDP set"),
        ("method PLAY failed: 455 (Method not valid)", "the camera refuses (455)"),
        ("Failed to resolve hostname x: Name or service not known", "the host name cannot be"),
        ("rtsp://admin:p@ss@h: something new", ""),
    ],
)
def test_reasons_are_recognised_and_nothing_else_is_said(line: str, reason: str) -> None:
    said = reason_in(f"[OPENCV:FFMPEG:16] {line}\n".encode())

    assert said.startswith(reason)
    assert bool(said) == bool(reason)
    assert "p@ss" not in said


# --- kills ----------------------------------------------------------------------------------------

CAMERA = "lobby"
FILM_SECONDS = 120
"""Longer than a grabber lives, as its camera must not end by itself."""
EVENTS_BETWEEN = 4
"""Stored between two kills, at least."""
BOX_EVERY = 4
"""Of the kills one in so many is of the supervisor; the grabber then ends by itself."""
Numbers = dict[str, list[int]]
"""The events of each boot of a grabber, by number."""


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """Serve a camera past which somebody walks every second, on one of three paths."""
    folder = tmp_path_factory.mktemp("camera")
    heights = (FILM_SECONDS // 3) * (0.4, 0.65, 0.9)
    people = [
        Person(line(3.0 + n, (-0.05, heights[n]), (1.05, heights[n]), 3.0), seed=n)
        for n in range(FILM_SECONDS - 6)
    ]
    transcode(Scene(people).film(folder / "made.mp4", FILM_SECONDS), folder / "film.mp4", FPS)
    with served(folder / "film.mp4") as number:
        yield number


def kill(box: Box, whole: bool) -> None:
    """Kill the grabber or the supervisor; what ends with it is started again."""
    before = box.grabbers[CAMERA]
    if whole:
        box.process.kill()
        box.process.wait()
        wait_for(lambda: not Path(f"/proc/{before}").exists(), "the grabber to end, too")
        box.start()
    else:
        os.kill(before, signal.SIGKILL)
    wait_for(lambda: box.grabbers.get(CAMERA, before) != before, "a grabber again")


def spooled(spool: Path) -> Numbers:
    """Return the events in a spool, delivered or not."""
    found: Numbers = defaultdict(list)
    with contextlib.closing(sqlite3.connect(spool)) as database:
        for boot, seq in database.execute("SELECT boot, seq FROM event ORDER BY id"):
            found[boot].append(seq)
    return found


def journalled(state: Path) -> Numbers:
    """Return the events in the journal."""
    found: Numbers = defaultdict(list)
    with contextlib.closing(Journal(state)) as journal:
        for _, entry in journal.entries():
            if entry is not None and entry.kind == "event":
                found[str(entry.boot)].append(entry.seq or 0)
    return found


@pytest.mark.campaign
@pytest.mark.timeout(1200)
@pytest.mark.skipif(missing() is not None, reason=f"needs an RTSP server: {missing()}")
def test_campaign_of_killed_grabbers(port: int, tmp_path: Path) -> None:
    kills, chance = size("GRAB_KILLS", 8), random.Random(1)
    with Daemon(small_config(tmp_path / "state")) as daemon:
        box = Box(tmp_path, daemon.endpoint, {CAMERA: f"rtsp://127.0.0.1:{port}/camera"})
        spool = spool_path(box.state, SiteSettings().name, CAMERA)
        with contextlib.closing(box):
            before = 0
            for number in range(kills + 1):
                wanted = before + EVENTS_BETWEEN
                wait_for(lambda n=wanted: daemon.status().events.stored >= n, "events", 60.0)  # type: ignore[misc]
                if number < kills:
                    time.sleep(chance.uniform(0.0, 1.0))
                    kill(box, whole=number % BOX_EVERY == BOX_EVERY - 1)
                    before = sum(map(len, spooled(spool).values()))
        kept = spooled(spool)

        # Deliver what the last one had not delivered, as the next grabber does.
        spool.rename(tmp_path / "spool.db")
        with (
            dial(small_config(tmp_path, daemon.endpoint)) as bus,
            publisher_on(bus, tmp_path, [CAMERA]) as publisher,
        ):
            assert publisher.wait_stored(WAIT_SECONDS)

    there = journalled(tmp_path / "state")
    assert there == kept
    assert len(there) == kills + 1, "a boot for each grabber, as each opens the spool anew"
    for numbers in there.values():
        assert numbers == list(range(1, len(numbers) + 1))
    print(f"{kills} kills, {sum(map(len, there.values()))} events of {len(there)} boots, 0 lost")
