"""`up`: daemon, grabbers and page of one machine, started again when they end."""

from __future__ import annotations

import argparse
import os
import pty
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from mosquitto import PROGRAM, mosquitto
from paths import ROOT
from serving import WAIT_SECONDS, camtopod, free_endpoint, wait_for

from bench.support.site import children
from camtopod.cli import exits
from camtopod.cli.cameras import camera_process
from camtopod.cli.commands import up as up_command
from camtopod.cli.main import main

START_SECONDS = 90.0
"""Time for three processes to start on a busy machine."""


class Up:
    """`camtopod up` of a site with a camera that is away, and one of another program."""

    def __init__(self, folder: Path, *options: str, **constants: object) -> None:
        self.config = folder / "camtopod.toml"
        self.config.write_text(
            f'[bus]\nlisten = ["{free_endpoint()}"]\n[state]\ndirectory = "{folder}/state"\n'
            '[cameras.lobby]\nsource = "rtsp://127.0.0.1:1/x"\n[cameras.frigate]\nat = [0.1, 0.2]\n'
        )
        self._log = folder / "log"
        with self._log.open("wb") as file:
            self.process = camtopod(
                *("--config", str(self.config), "up", "--listen", "127.0.0.1:0", *options),
                constants={
                    f"{up_command.__name__}:{name}": value for name, value in constants.items()
                },
                stderr=file,
            )

    @property
    def log(self) -> str:
        return self._log.read_text()

    def says(self, *words: str) -> None:
        """Wait until all is in the log."""
        wait_for(lambda: all(word in self.log for word in words), str(words), START_SECONDS)

    def children(self) -> list[int]:
        """The processes of this configuration beside the first one."""
        found = []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            try:
                words = path.read_bytes().split(b"\0")
            except OSError:  # it has ended meanwhile
                continue
            if str(self.config).encode() in words and b"--with-parent" in words:
                found.append(int(path.parent.name))
        return found

    def child(self, command: str) -> int:
        [found] = [
            child
            for child in self.children()
            if command.encode() in Path(f"/proc/{child}/cmdline").read_bytes().split(b"\0")
        ]
        return found


@pytest.fixture
def started() -> Iterator[list[Up]]:
    """Leave nothing behind."""
    running: list[Up] = []
    yield running
    for up in running:
        up.process.kill()
        up.process.wait()
        wait_for(lambda up=up: not up.children(), "its processes to end")  # type: ignore[misc]


def test_all_runs_until_it_is_stopped_and_what_dies_is_started_again_alone(
    tmp_path: Path, started: list[Up]
) -> None:
    up = Up(tmp_path)
    started.append(up)
    up.says("info: page: the page is at http://", "info: daemon: site site", "camera lobby is")
    where = up.log.partition("info: page: the page is at ")[2].split()[0]
    with urllib.request.urlopen(where, timeout=WAIT_SECONDS) as answer:
        assert b"camtopod" in answer.read()
    assert len(up.children()) == 3, "daemon, page and one camera"
    grabber, page, daemon = up.child("grab"), up.child("web"), up.child("run")

    os.kill(page, signal.SIGKILL)
    up.says("warning: page: killed by signal 9 (Killed); restarting in ")
    [learner] = [
        child
        for child in children(daemon)
        if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()
    ]
    os.kill(learner, signal.SIGKILL)
    up.says("warning: daemon: ended with status 1; restarting in ")
    wait_for(lambda: up.log.count("info: page: the page is at http://") == 2, "the page")
    wait_for(lambda: up.log.count("info: daemon: site site") == 2, "the daemon", START_SECONDS)
    os.kill(up.child("run"), signal.SIGTERM)
    wait_for(lambda: up.log.count("info: daemon: site site") == 3, "the daemon", START_SECONDS)

    assert up.child("grab") == grabber
    assert up.process.poll() is None
    up.process.send_signal(signal.SIGINT)
    assert up.process.wait(WAIT_SECONDS) == exits.DONE
    assert up.children() == []
    assert up.log.splitlines()[-1].endswith("info: daemon: ended cleanly")
    assert up.log.count(str(up.config)) == 0, "each part would name it"


@pytest.mark.skipif(PROGRAM is None, reason="needs the broker mosquitto (Debian: mosquitto)")
def test_a_broker_may_come_later(tmp_path: Path, started: list[Up]) -> None:
    from paho.mqtt import subscribe

    with mosquitto(tmp_path) as broker:
        broker.stop()
        address = f"mqtt://127.0.0.1:{broker.port}"
        up = Up(tmp_path, "--bridge", address, PAGE_NEEDS="nothing_of_this_name")
        started.append(up)
        up.says("there is no page: pip install 'camtopod[web]'", "camera lobby is")
        up.says("warning: bridge: ended with status 1; restarting in ")

        assert broker.start()
        subscribe.simple("camtopod/#", hostname="127.0.0.1", port=broker.port)
        assert up.process.poll() is None


def test_a_part_that_hangs_is_started_again(caplog: pytest.LogCaptureFixture) -> None:
    none = {"config": None, "log_format": "text", "site": None, "connect": []}
    part = up_command._Part(argparse.Namespace(**none), "run")
    command = [sys.executable, "-c", "import signal; signal.pause()"]
    part.look_after(0.0, command)
    hung = up_command.HUNG_SECONDS + camera_process.START_SECONDS + 1.0
    part.look_after(hung, command)
    assert part.process is not None
    assert part.process.wait(WAIT_SECONDS) == -signal.SIGABRT
    part.look_after(hung, command)

    assert part.start_at is not None
    assert part.start_at > hung
    assert "daemon: hung for 61 s while connecting; restarting in" in caplog.text


def test_a_terminal_may_stop_background_jobs_that_write(tmp_path: Path) -> None:
    config = tmp_path / "camtopod.toml"
    config.write_text(f'[bus]\nlisten = ["{free_endpoint()}"]\n[state]\ndirectory = "{tmp_path}"\n')
    terminal, far_end = pty.openpty()
    # The first terminal that the leader of a session opens is the session's.
    start = f'exec < {os.ttyname(far_end)} > {os.ttyname(far_end)} 2>&1; stty tostop; exec "$@"'
    command = [
        sys.executable,
        "-m",
        "camtopod",
        "--config",
        config,
        "up",
        "--listen",
        "127.0.0.1:0",
    ]
    process = subprocess.Popen(
        ["sh", "-c", start, "sh", *command], cwd=ROOT, start_new_session=True
    )
    try:
        said = b""
        while not all(word in said for word in (b"daemon: site site", b"the page is at")):
            said += os.read(terminal, 4096)
        process.send_signal(signal.SIGHUP)
        while b"no camera runs here: a change needs a restart" not in said:
            said += os.read(terminal, 4096)
        process.terminate()
        while not said.rstrip().endswith(b"daemon: ended cleanly"):
            said += os.read(terminal, 4096)
        assert process.wait(WAIT_SECONDS) == exits.DONE
    finally:
        process.kill()
    os.close(terminal)
    os.close(far_end)


def test_when_it_is_killed_nothing_stays(tmp_path: Path, started: list[Up]) -> None:
    up = Up(tmp_path)
    started.append(up)
    up.says("camera lobby is")
    up.process.kill()
    wait_for(lambda: not up.children(), "all to end")
    assert up.children() == []


def test_the_status_is_that_of_the_part(tmp_path: Path, started: list[Up]) -> None:
    up = Up(tmp_path, "--listen", "nonsense")
    started.append(up)
    assert up.process.wait(START_SECONDS) == exits.USAGE
    assert "camtopod: --listen 'nonsense': write it like 127.0.0.1:8780" in up.log
    said = "camtopod: page: ended with status 2, see above; all has been stopped"
    assert up.log.splitlines()[-1] == said


def test_without_a_configuration_it_says_how_to_make_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("camtopod.cli.main.PLACES", (Path("camtopod.toml"),))
    assert main(["up"]) == exits.USAGE
    assert "camtopod init lobby=rtsp://" in capsys.readouterr().err
