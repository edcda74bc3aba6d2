"""`camtopod forget`, `rename`, `reset`: by a daemon, and in a state directory."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from fake_bus_daemon import put, running
from serving import (
    all_out,
    camtopod,
    closing_event,
    free_endpoint,
    numbered,
    small_config,
    wait_for,
    walkers,
)

from camtopod.cli import exits
from camtopod.cli.main import main
from camtopod.config.config_file import load
from camtopod.records import GrabberStatus
from camtopod.serve.bus import Bus, dial
from camtopod.serve.daemon import Daemon
from camtopod.serve.ingest import read_names
from camtopod.serve.storage import Journal

EVENTS = [*numbered(walkers(60)), closing_event()]


def cameras(daemon: Daemon) -> set[str]:
    topology = daemon.topology
    return set() if topology is None else {camera.id for camera in topology.cameras}


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Daemon]:
    with running(tmp_path / "hq", free_endpoint(), site="hq") as one:
        with dial(small_config(tmp_path, one.endpoint)) as bus:
            bus.site = "hq"
            put(bus, *EVENTS)
            wait_for(lambda: all_out(one, len(EVENTS)), "all to be learned")
        yield one


def told(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    capsys.readouterr()
    status = main(["--config", "none", *arguments])
    out, err = capsys.readouterr()
    return status, out, err


def test_the_commands_reach_the_daemon(
    daemon: Daemon, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "c.toml"
    config.write_text('[cameras.b]\nsource_file = "on-another-machine"\n')
    hq = ("--config", str(config), "--connect", daemon.endpoint, "--site", "hq")
    status, out, _ = told(capsys, *hq, "forget", "b")
    assert (status, out.startswith("b is forgotten")) == (0, True)
    wait_for(lambda: "b" not in cameras(daemon), "the version")
    assert told(capsys, *hq, "forget", "b", "--take-back")[0] == 0
    assert told(capsys, *hq, "rename", "c", "yard")[0] == 0
    wait_for(lambda: "yard" in cameras(daemon), "the version")
    status, _, err = told(capsys, *hq, "forget", "bb")
    assert status == exits.FAILED
    assert "there is no camera bb; there are: " in err
    epoch = daemon.epoch
    assert told(capsys, *hq, "reset", "--yes")[0] == 0
    wait_for(lambda: daemon.epoch > epoch and not cameras(daemon), "the reset")


def test_the_commands_for_other_sites_are_printed(
    daemon: Daemon, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Sites of the configuration, and those that a grabber's status names."""
    config = tmp_path / "c.toml"
    config.write_text(
        f'[site]\nname = "hq"\n[bus]\nconnect = ["{daemon.endpoint}"]\n'
        '[sites.annex]\nconnect = ["tcp/annex:7447"]\n[cameras.b]\nsites = ["hq", "annex"]\n'
    )
    status = GrabberStatus("running", camera="c", sites=["hq", "mill"], owner="hq")
    last = "site {} is unchanged; with its certificate: camtopod {}"
    hq = ("--config", str(config))
    with dial(load(config)) as bus:
        bus.answer_queries("status/c", lambda *_: status, "status")

        def lines(*command: str) -> list[str]:
            capsys.readouterr()
            assert main([*hq, *command]) == 0
            return capsys.readouterr().out.splitlines()[1:]

        there = "--site annex --connect tcp/annex:7447"
        assert lines("forget", "b") == [last.format("annex", f"{there} forget b")]
        assert lines("forget", "b", "--take-back") == [
            last.format("annex", f"{there} forget b --take-back")
        ]
        assert lines("rename", "c", "yard") == [
            last.format("mill", "--site mill rename c yard"),
        ]
        assert lines("forget", "a") == []
        assert lines("reset", "--yes") == [
            last.format("annex", f"{there} reset"),
            last.format("mill", "--site mill reset"),
        ]


def test_a_site_that_was_not_named_is_left_alone(
    daemon: Daemon, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = told(capsys, "--connect", daemon.endpoint, "forget", "b")
    assert (status, out) == (exits.BUS, "")
    assert "no daemon of site site answers" in err
    assert "there is a daemon of site hq: add --site hq" in err
    assert "b" in cameras(daemon)


def test_a_reset_has_to_be_confirmed(
    daemon: Daemon, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    hq = ("--connect", daemon.endpoint, "--site", "hq")
    monkeypatch.setattr(sys, "stdin", io.StringIO("hq\n"))
    status, _, err = told(capsys, *hq, "reset")
    assert (status, "confirm it with --yes" in err) == (exits.USAGE, True)

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr(sys, "stdin", Terminal("no\n"))
    assert told(capsys, *hq, "reset")[0] == exits.FAILED
    assert set("abc") <= cameras(daemon)
    monkeypatch.setattr(sys, "stdin", Terminal("hq\n"))
    assert told(capsys, *hq, "reset")[0] == exits.DONE


# --- kill -9 --------------------------------------------------------------------------------------


def stored(bus: Bus) -> bytes:
    """Return the daemon's status as JSON."""
    return bus.query("status/daemon", {"format": "application/json"}, one=True)[0][1]


def test_what_was_answered_survives_a_kill(tmp_path: Path) -> None:
    """The daemon is killed as soon as the command has printed its answer."""
    state = tmp_path / "state"
    endpoint = free_endpoint()
    config = tmp_path / "camtopod.toml"
    config.write_text(f'[bus]\nlisten = ["{endpoint}"]\n[state]\ndirectory = "{state}"\n')
    run = camtopod("--config", str(config), "run", stderr=subprocess.PIPE)
    assert run.stderr is not None
    assert any(b"ready at" in line for line in run.stderr)
    with dial(small_config(tmp_path, endpoint)) as bus:
        put(bus, *EVENTS)
        wait_for(lambda: b'"stored":0' not in stored(bus), "events to be stored")
    forget = camtopod("--connect", endpoint, "forget", "b", stdout=subprocess.PIPE)
    assert forget.stdout is not None
    assert forget.stdout.readline().startswith(b"b is forgotten")
    os.kill(run.pid, signal.SIGKILL)
    run.communicate(timeout=60)
    forget.communicate(timeout=60)

    journal = Journal(state)
    forgotten = read_names(journal).forgotten
    commands = [entry for _, entry in journal.entries() if entry and entry.kind == "command"]
    journal.close()
    assert (set(forgotten), len(commands)) == ({"b"}, 1)
