"""SIGTERM and SIGHUP to the real programs at any moment.

They end, lose nothing, and no SIGHUP ends them. The quick form takes a few moments; the
campaign many.
"""

from __future__ import annotations

import contextlib
import itertools
import random
import re
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from grabber import publisher_on, stored
from serving import (
    AT_ONCE,
    T0,
    WAIT_SECONDS,
    camtopod,
    free_endpoint,
    small_config,
    wait_for,
    walkers,
)
from sizes import size

from camtopod.config.settings import BusSettings
from camtopod.records import Event
from camtopod.serve.bus import dial
from camtopod.serve.daemon import Daemon

START_SECONDS = {"grab": 2.0, "run": 3.0}
"""Moments are drawn from this long after the start; what it takes until events are stored is in it."""


class Under:
    """Runs a program repeatedly and sends it signals."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.endpoint = free_endpoint()
        self.file = directory / "c.toml"
        self.file.write_text(
            f'[bus]\nlisten = ["{self.endpoint}"]\nconnect_seconds = 0.3\n[state]\ndirectory = "{directory}/state"\n'
            "[learn]\nlateness_seconds = 2400\n"
            '[cameras.lobby]\nsource = "rtsp://127.0.0.1:1/x"\n'
            '[cameras.hall]\nsource = "rtsp://127.0.0.1:1/x"\n'
        )
        self.file.chmod(0o600)
        self._log = (directory / "log").open("ab")
        self.started: list[subprocess.Popen[bytes]] = []

    @property
    def log(self) -> str:
        return (self.directory / "log").read_text()

    def start(self, command: str) -> subprocess.Popen[bytes]:
        process = camtopod(
            *("--config", str(self.file), command),
            stderr=self._log,
            constants=AT_ONCE if command == "run" else {},
            preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
        )
        self.started.append(process)
        return process

    @staticmethod
    def listens(process: subprocess.Popen[bytes]) -> bool:
        """Return True if the program catches or ignores SIGHUP; the interpreter does not."""
        with contextlib.suppress(OSError):
            status = Path(f"/proc/{process.pid}/status").read_text()
            masks = re.findall(r"^Sig(?:Cgt|Ign):\s+(\w+)", status, re.MULTILINE)
            return any(int(mask, 16) & 1 << signal.SIGHUP - 1 for mask in masks)
        return False

    def running(self) -> list[int]:
        """Return the processes of this configuration that run."""
        found = []
        for entry in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if str(self.file).encode() in (entry / "cmdline").read_bytes():
                    found.append(int(entry.name))
        return found

    def close(self) -> None:
        for process in self.started:
            process.kill()
            process.wait()
        self._log.close()


@pytest.fixture
def under(tmp_path: Path) -> Iterator[Under]:
    one = Under(tmp_path)
    yield one
    one.close()


def at_moments(under: Under, command: str, count: int, chance: random.Random) -> None:
    """Start the program ``count`` times; send SIGHUPs and a SIGTERM at random moments."""
    for number in range(count):
        process = under.start(command)
        wait_for(lambda one=process: under.listens(one), "it to listen", interval=0.002)  # type: ignore[misc]
        until = time.monotonic() + START_SECONDS[command] * chance.random() ** 2
        while time.monotonic() < until:
            process.send_signal(signal.SIGHUP)
            time.sleep(chance.uniform(0.0, 0.2))
        assert process.poll() is None, f"run {number}: SIGHUP ended it\n{under.log[-3000:]}"

        process.send_signal(signal.SIGTERM)
        if chance.random() < 0.5:
            process.send_signal(signal.SIGHUP)

        # Before it catches SIGTERM, and again at the very end, the signal itself ends it.
        status = process.wait(WAIT_SECONDS)
        assert status in (0, -signal.SIGTERM), f"run {number}: {status}\n{under.log[-3000:]}"
    assert "Traceback" not in under.log, under.log[-5000:]


def daemon_at_moments(under: Under, count: int, seed: int) -> None:
    """Signal a daemon while a publisher runs; in the end each event is in the journal once."""
    state = under.directory / "state"
    before = walkers(150)
    bus_settings = BusSettings(listen=(under.endpoint,))
    config = msgspec.structs.replace(small_config(state), bus=bus_settings)
    with contextlib.ExitStack() as stack:
        with Daemon(config):
            bus = stack.enter_context(dial(small_config(under.directory, under.endpoint)))
            publisher = stack.enter_context(publisher_on(bus, under.directory, ["lobby"]))
            publisher.publish(*before)
            assert publisher.wait_stored(WAIT_SECONDS)

        # Publish on while daemons come and go.
        stop, numbers = threading.Event(), itertools.count()

        def publish() -> None:
            while not stop.wait(0.005):
                publisher.publish(Event("lobby", "entry", T0 + 0.01 * next(numbers)))

        thread = threading.Thread(target=publish)
        thread.start()
        try:
            at_moments(under, "run", count, random.Random(seed))
        finally:
            stop.set()
            thread.join()
        with Daemon(config) as daemon:
            assert publisher.wait_stored(WAIT_SECONDS)
            assert daemon.failing() == []

    seqs = [seq for seq, _ in stored(state)][len(before) :]
    assert seqs == list(range(1, next(numbers) + 1))


def test_the_daemon_at_a_few_moments(under: Under) -> None:
    daemon_at_moments(under, 2, seed=2)  # the first ends while events are stored


def test_grabbers_at_a_moment_and_they_end_with_the_one_above_them(under: Under) -> None:
    at_moments(under, "grab", 1, random.Random(2))
    assert not under.running()

    box = under.start("grab")
    wait_for(lambda: len(under.running()) == 3, "a process for each camera")
    box.kill()
    box.wait()
    wait_for(lambda: not under.running(), "their end")


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_the_daemon_at_moments(under: Under) -> None:
    daemon_at_moments(under, size("SIGNALS", 40), seed=3)


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_grabbers_at_many_moments(under: Under) -> None:
    at_moments(under, "grab", size("SIGNALS", 40), random.Random(4))
    assert not under.running()
