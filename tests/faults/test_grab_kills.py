"""kill -9 of real grabbers and their supervisor while events flow.

All events of a spool are in the journal, and none twice.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import sqlite3
import subprocess
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest
from rendered_scenes import FPS, Person, Scene, line
from serving import WAIT_SECONDS, camtopod, small_config, wait_for
from sizes import size
from test_cameras import children_of

from bench.support.rtsp_streams import missing, served, transcode
from camtopod.config.settings import KeepSettings, SiteSettings
from camtopod.serve.bus.session import dial
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox import spool_path
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage.journal import Journal

CAMERA = "lobby"
FILM_SECONDS = 120.0
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
    people = [
        Person(line(3.0 + n, (-0.05, height), (1.05, height), 3.0), seed=n)
        for n, height in zip(range(round(FILM_SECONDS) - 6), 100 * (0.4, 0.65, 0.9), strict=False)
    ]
    film = Scene(people).film(folder / "made.mp4", FILM_SECONDS)
    transcode(film, folder / "film.mp4", FPS)
    with served(folder / "film.mp4") as number:
        yield number


QUICK = {
    "camtopod.cli.cameras.camera_process:RESTART_SECONDS_MIN": 0.1,
    "camtopod.cli.cameras.camera_process:RESTART_SECONDS_MAX": 0.2,
}


class Box:
    """`camtopod grab` of one camera, in a process under a supervisor."""

    def __init__(self, directory: Path, endpoint: str, port: int) -> None:
        self._log, self._config = directory / "log", directory / "box.toml"
        state = directory / "box"
        self.spool = spool_path(state, SiteSettings().name, CAMERA)
        self._config.write_text(
            f'[bus]\nconnect = ["{endpoint}"]\n[state]\ndirectory = "{state}"\n'
            f'[cameras.{CAMERA}]\nsource = "rtsp://127.0.0.1:{port}/camera"\n'
        )
        self._process: subprocess.Popen[bytes] | None = None
        self.start()

    def start(self) -> None:
        with self._log.open("ab") as log:
            self._process = camtopod(
                "--config", str(self._config), "grab", constants=QUICK, stderr=log
            )

    @property
    def grabber(self) -> int | None:
        """The process id of the grabber, if there is one."""
        assert self._process is not None
        return children_of(self._process.pid).get(CAMERA)

    def kill(self, whole: bool) -> None:
        """Kill with SIGKILL; what ends with it is started again."""
        before = self.grabber
        assert before is not None
        assert self._process is not None
        if whole:
            self._process.kill()
            self._process.wait()
            wait_for(lambda: not Path(f"/proc/{before}").exists(), "the grabber to end, too")
            self.start()
        else:
            os.kill(before, signal.SIGKILL)
        wait_for(lambda: self.grabber not in (None, before), "a grabber again")

    def close(self) -> None:
        assert self._process is not None
        self._process.terminate()
        assert self._process.wait(WAIT_SECONDS) == 0, self._log.read_text()[-3000:]


def spooled(path: Path) -> Numbers:
    """Return the events in the spool, delivered or not."""
    found: Numbers = defaultdict(list)
    with contextlib.closing(sqlite3.connect(path)) as database:
        for boot, seq in database.execute("SELECT boot, seq FROM event ORDER BY id"):
            found[boot].append(seq)
    return found


def stored(state: Path) -> Numbers:
    """Return the events in the journal."""
    found: Numbers = defaultdict(list)
    with contextlib.closing(Journal(state, KeepSettings())) as journal:
        for _, entry in journal.entries():
            if entry is not None and entry.kind == "event":
                assert entry.boot is not None
                assert entry.seq is not None
                found[entry.boot].append(entry.seq)
    return found


def send_the_rest(path: Path, daemon: Daemon, directory: Path) -> None:
    """Deliver the events that a killed grabber had not delivered, as the next one does."""
    with (
        contextlib.closing(Spool(path, "last", 100_000)) as spool,
        dial(small_config(directory, daemon.endpoint)) as bus,
    ):
        publisher = Publisher(spool)
        publisher.attach(bus, [CAMERA])
        assert publisher.wait_stored(WAIT_SECONDS)
        publisher.close()


def await_events(daemon: Daemon, count: int) -> None:
    """Wait until so many events are stored."""
    wait_for(lambda: bool(daemon.status().events["stored"] >= count), f"{count} events", 60.0)


def killed(directory: Path, port: int, kills: int) -> None:
    """Kill again and again, each time in the middle of a grabber's events."""
    chance = random.Random(1)
    with Daemon(small_config(directory / "state")) as daemon:
        with contextlib.closing(Box(directory, daemon.endpoint, port)) as box:
            before = 0
            for number in range(kills + 1):
                await_events(daemon, before + EVENTS_BETWEEN)
                if number < kills:
                    time.sleep(chance.uniform(0.0, 1.0))
                    box.kill(whole=number % BOX_EVERY == BOX_EVERY - 1)
                    before = sum(map(len, spooled(box.spool).values()))
        kept = spooled(box.spool)
        send_the_rest(box.spool, daemon, directory)
    there = stored(directory / "state")
    assert there == kept
    assert len(there) == kills + 1, "a boot for each grabber, as each opens the spool anew"
    for numbers in there.values():
        assert numbers == list(range(1, len(numbers) + 1))
    print(f"{kills} kills, {sum(map(len, there.values()))} events of {len(there)} boots, 0 lost")


@pytest.mark.campaign
@pytest.mark.timeout(1200)
@pytest.mark.skipif(missing() is not None, reason=f"needs an RTSP server: {missing()}")
def test_campaign_of_killed_grabbers(port: int, tmp_path: Path) -> None:
    killed(tmp_path, port, size("GRAB_KILLS", 8))
