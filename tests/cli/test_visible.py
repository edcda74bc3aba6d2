"""Texts of others do not act on a terminal, and cannot start a line of the log."""

from __future__ import annotations

import contextlib
import json
import logging
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
import serving
from hypothesis import given, strategies as st
from serving import free_endpoint, small_config, wait_for
from test_watch import Terminal

from camtopod import codec
from camtopod.cli.commands.watch import lines
from camtopod.cli.common import _Formatter
from camtopod.cli.events.event_lines import LineReader
from camtopod.cli.main import main
from camtopod.cli.terminal.site_state import SiteState
from camtopod.records import (
    TOPOLOGY_SCHEMA,
    Alarm,
    Camera,
    Link,
    NextCamera,
    Prediction,
    Topology,
    Transit,
)
from camtopod.serve.bus import session as buses
from camtopod.serve.bus.session import Bus
from camtopod.serve.daemon import Daemon
from camtopod.visible import visible, visible_lines

HOSTILE = "run\x1b[2Jning \x1b]0;OWNED\x07\x9b31m\u202eright\u2028to\u2066left\r\nerror: FORGED\x7f\ud800\x00"
ACTING = re.compile(r"[^\x20-\x7e]")
"""Of `HOSTILE` nothing may be left but what ASCII prints."""


def test_what_is_printable_stays() -> None:
    assert visible("Küche, 廊下, ≤ 3 m") == "Küche, 廊下, ≤ 3 m"
    assert visible("a\x1b[2Jb\nc\u202ed") == "a\\u001b[2Jb\\nc\\u202ed"
    assert visible_lines("a\nb\x07\n\nc") == "a\n    b\\u0007\n    \n    c"


@given(st.text(st.characters()))
def test_nothing_else_is_left_and_json_stays_json(text: str) -> None:
    assert visible(text).isprintable()
    if not re.search("[\ud800-\udfff]", text):  # two halves become one character
        assert json.loads(visible(json.dumps(text, ensure_ascii=False))) == text


@pytest.mark.parametrize("form", ["text", "logfmt", "json"])
def test_a_message_is_one_line_in_every_form(form: str) -> None:
    record = logging.LogRecord(
        "camtopod.x", logging.WARNING, "", 0, "rejected event/%s", (HOSTILE,), None
    )
    line = _Formatter(form).format(record)
    assert ACTING.search(line) is None, line
    if form == "json":
        assert json.loads(line)["message"] == f"rejected event/{HOSTILE}"


@pytest.mark.parametrize("form", ["text", "logfmt", "json"])
def test_a_traceback_is_indented(form: str) -> None:
    try:
        raise ValueError(HOSTILE)
    except ValueError as error:
        record = logging.LogRecord(
            "x", logging.ERROR, "", 0, "it failed", (), (ValueError, error, error.__traceback__)
        )
    first, *others = _Formatter(form).format(record).split("\n")
    assert "it failed" in first
    assert all(line.startswith("    ") for line in others)
    assert ACTING.search("".join([first, *others])) is None


def full_of_it() -> tuple[SiteState, Topology]:
    """Return a site and a topology with `HOSTILE` in every text."""
    site = SiteState(HOSTILE)
    said = HOSTILE.replace("\ud800", "")  # MessagePack has no half characters
    status = {"state": said, "reason": said}
    site.on_status("status/cam1", msgspec.msgpack.encode(status))
    site.on_status(f"status/{said}", msgspec.msgpack.encode(status))
    cameras = {said: {"events": 1, "newest": 1.0, "alive": True}}
    site.on_status("status/daemon", msgspec.msgpack.encode({**status, "cameras": cameras}))
    onward = [NextCamera(said, said, 0.5, 1.0, 2.0, 3.0)]
    site.on_prediction(
        "prediction/cam1", codec.to_msgpack(Prediction(said, said, 1.0, said, 1, 0.5, onward))
    )
    link = Link(said, said, "unseen", 0.5, 3.0, Transit(1, 1, 1, 1, 1, 1), 0.0, 0.1)
    alarms = [Alarm(1, 1.0, said, said, said)]
    topology = Topology(
        TOPOLOGY_SCHEMA,
        said,
        said,
        1,
        1.0,
        1,
        said,
        [Camera(said, [])],
        [],
        [link],
        [],
        alarms=alarms,
    )
    return site, topology


def test_watch_shows_it_and_does_not_obey_it() -> None:
    site, topology = full_of_it()
    text = lines(site, topology, 2.0, None)
    assert sum("OWNED" in line for line in text) >= 5
    assert [line for line in text if ACTING.search(line)] == []
    assert sum("FORGED" in line and line.startswith("error") for line in text) == 0


@contextlib.contextmanager
def hostile_site(folder: Path) -> Iterator[tuple[Bus, Daemon]]:
    """Run a daemon, and a client on its open bus that publishes `HOSTILE` in every place."""
    said = HOSTILE.replace("\ud800", "")
    with (
        Daemon(small_config(folder / "state")) as daemon,
        contextlib.closing(buses.dial(small_config(folder, daemon.endpoint))) as bus,
    ):
        bus.answer_queries(
            "status/cam1", lambda key, parameters: {"state": said, "reason": said}, "status"
        )
        bus.answer_queries(
            "status/x\nFORGED", lambda key, parameters: {"state": said, said: said}, "status"
        )
        bus.announce("grabber", "y\x1b[2J\nFORGED")
        bus.announce("daemon", "z\x1b[2J\nFORGED")
        yield bus, daemon


def test_a_terminal_and_the_doctor_get_none_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("COLUMNS", raising=False)
    said = HOSTILE.replace("\ud800", "")
    with hostile_site(tmp_path) as (bus, daemon):
        terminal = Terminal("--connect", daemon.endpoint, "watch", columns=200, rows=50)

        def shown() -> bool:
            bus.publish(
                "status/cam1", {"state": said, "reason": said}, "status"
            )  # as grabbers do, again and again
            return "OWNED" in terminal.text

        wait_for(shown, "what it says of itself")
        bus.publish(
            "status/cam1",
            {"state": "\x1b]52;c;ZWNobw==\x07", "reason": "\x1b]0;AGAIN\x07"},
            "status",
        )
        wait_for(lambda: "AGAIN" in terminal.text, "what it says then")
        assert terminal.close() == 0
        assert main(["--connect", daemon.endpoint, "doctor"]) == 0
    for written in ("\x1b]", "\x07", "\x9b", "\u202e", "\nFORGED", "\nerror"):
        assert written not in terminal.text
    report = capsys.readouterr().out
    assert report.count("OWNED") >= 2
    assert [
        line for line in report.splitlines() if ACTING.search(line) or line.startswith("FORGED")
    ] == []


def test_no_name_on_the_bus_makes_a_line_of_the_log(tmp_path: Path) -> None:
    endpoint, log = free_endpoint(), tmp_path / "log"
    settings = tmp_path / "c.toml"
    settings.write_text(
        f'[bus]\nlisten = ["{endpoint}"]\n[state]\ndirectory = "{tmp_path}/state"\n', "utf-8"
    )
    with log.open("wb") as file:
        process = serving.camtopod("--config", str(settings), "run", stderr=file)
    try:
        wait_for(lambda: "ready at" in log.read_text("utf-8"), "the daemon")
        with contextlib.closing(buses.dial(small_config(tmp_path, endpoint))) as bus:
            bus.announce("daemon", "x\nFORGED\x1b[2J")
            bus.publish_raw(
                "event/x\n2026-01-01T00:00:00Z error: FORGED\x1b[2J\u202e", b"\xc1", "event"
            )
            bus.publish_raw("event/y", b'{"camera":"y\\nFORGED","kind":"\\u001b[2J\\n"}', "event")
            wait_for(lambda: log.read_text("utf-8").count("rejected") >= 2, "what is rejected")
            (status,) = [msgspec.msgpack.decode(raw) for _, raw in bus.query("status/daemon")]
    finally:
        process.terminate()
        assert process.wait(20) == 0
    assert (status["state"], status["reason"]) == ("running", ""), "what is no name is no daemon"
    text = log.read_text("utf-8")
    assert "FORGED" in text
    assert [line for line in text.split("\n") if not line.isprintable()] == []
    assert [line for line in text.splitlines() if line.startswith(("FORGED", "2026-01-01"))] == []


def test_a_line_of_a_file_is_quoted_so(capsys: pytest.CaptureFixture[str]) -> None:
    LineReader().reject("malformed", "events.jsonl:1: x", HOSTILE.encode("utf-8", "surrogatepass"))
    (line,) = capsys.readouterr().err.splitlines()
    assert ACTING.search(line) is None


def test_what_ends_a_command_is_said_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for form in ("text", "logfmt", "json"):
        assert (
            main(["--log-format", form, "export", "--format", "dot", f"{tmp_path}/\x1b[2J\x9bx"])
            == 66
        )
        (line,) = capsys.readouterr().err.splitlines()
        assert ACTING.search(line) is None


def test_a_crash_is_told_so() -> None:
    code = (
        "import camtopod.cli.main as m; m.main = lambda: 1 / int('\\x1b[2J\\nFORGED'); m.console()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 1
    assert "ValueError" in done.stderr
    assert "\x1b" not in done.stderr
    assert all(line.startswith("    ") for line in done.stderr.splitlines()[1:])
