"""Texts of others do not act on a terminal, and cannot start a line of the log."""

from __future__ import annotations

import contextlib
import json
import re
from pathlib import Path

import msgspec
import serving
from hypothesis import given, strategies as st
from serving import free_endpoint, small_config, wait_for

from camtopod import codec
from camtopod.cli.commands.watch import parts
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
from camtopod.serve import bus as buses
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
    cameras_learned = [Camera(said, [])]
    head = (TOPOLOGY_SCHEMA, said, said, 1, 1.0, 1, said)
    return site, Topology(*head, cameras_learned, [], [link], [], alarms=alarms)


def test_watch_shows_it_and_does_not_obey_it() -> None:
    site, topology = full_of_it()
    text = "\n".join(parts(site, topology, 2.0)).split("\n")
    assert sum("OWNED" in line for line in text) >= 5
    assert [line for line in text if ACTING.search(line)] == []
    assert sum("FORGED" in line and line.startswith("error") for line in text) == 0


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
