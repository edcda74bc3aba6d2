"""`camtopod watch`: as lines, on screens of any size, in a real terminal, over daemon restarts."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios
import threading
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from model_rows import CameraModel, Model, with_rows
from serving import camtopod, free_endpoint, small_config, wait_for

from camtopod import codec, learn_topology
from camtopod.cli.commands import watch
from camtopod.cli.main import main
from camtopod.cli.terminal.site_state import ALARMS_SHOWN, SiteState, topology_lines
from camtopod.config.settings import BusSettings
from camtopod.records import (
    TOPOLOGY_SCHEMA,
    Alarm,
    Camera,
    Event,
    Link,
    NextCamera,
    Prediction,
    SelfScore,
    Topology,
    Transit,
)
from camtopod.serve.daemon import Daemon
from camtopod.topology import waiting_for_links
from camtopod.words import ELSEWHERE, OLD_SECONDS, SILENT_SECONDS_MIN

NOW = 1_700_007_200.0
NOTHING = Topology(TOPOLOGY_SCHEMA, "hq", "01J", 9, 1_700_003_600.0, 0, "sha256:0", [], [], [], [])
SCORE = SelfScore(200, 3, 1.25, 0.81, 0.93, 1.75, 0.55)
REASON = "the source cannot be opened: [red]nothing listens; trying again in 3.5 s"


def lines(site: SiteState, topology: Topology | None = None) -> list[str]:
    return "\n\n".join(watch.parts(site, topology, NOW)).split("\n")


def cameras(site: SiteState, topology: Topology | None = None) -> dict[str, str]:
    """Return the state and the reason of each camera."""
    rows = [line[2:] for line in site.camera_lines(topology, NOW)]
    return {row.split()[0]: f"{row[21:34].strip()} {row[55:]}".strip() for row in rows}


def topology(alarms: int = 0, score: SelfScore | None = None, links: int = 0) -> Topology:
    """Return a version with alarms, an hour old each, and links, the last one the busiest."""
    listed = [
        Alarm(k, NOW - 3600.0, "link_closed", f"lobby/{k}->hall/2", "share 0.60, 0.00 since")
        for k in range(alarms)
    ]
    transit = Transit(7.8, 8.1, 1.9, -6.2, 7.9, 10.4)
    found = [
        Link(f"lobby/{k}", "hall/2", "unseen", 0.4, float(k), transit, 0.0, 0.1)
        for k in range(links)
    ]
    return msgspec.structs.replace(NOTHING, alarms=listed or None, score=score, links=found)


def publish(site: SiteState, name: str, **status: object) -> None:
    site.on_status(f"status/{name}", msgspec.msgpack.encode(status))


def busy_site(cameras: int, steady: Callable[[], float] = lambda: 100.0) -> SiteState:
    """Return a site with cameras, one in ten of them with a problem, a daemon, and predictions."""
    site = SiteState("hq", steady)
    counters = {
        f"cam{k:04}": {"events": k, "newest": NOW - k, "alive": True} for k in range(cameras)
    }
    events, rejects = {"stored": 77}, {"malformed": 2}
    publish(site, "daemon", state="running", cameras=counters, events=events, rejects=rejects)
    for k in range(cameras):
        if k % 10 == 7:
            publish(site, f"cam{k:04}", state="stalled", reason=REASON)
        else:
            publish(site, f"cam{k:04}", state="running", reason="")
    following = [
        NextCamera("hall", "hall/2", 0.61, 6.2, 7.9, 10.4),
        NextCamera("bar", "bar/1", 0.2, -3.0, 1.0, -1.0),
    ]
    for k in range(3):
        prediction = Prediction("lobby", f"lobby/{k}", NOW - 3.0 + k, "17", 9, 0.2, following)
        site.on_prediction("prediction/lobby", codec.to_msgpack(prediction))
    return site


# --- lines ---------------------------------------------------------------------------------------


def test_everything_is_shown_newest_and_worst_first() -> None:
    text = lines(busy_site(9), topology(ALARMS_SHOWN + 2, SCORE, links=2))

    assert text[0] == (
        "site hq: daemon running, 7 alarms, 1 camera needs attention, 77 events stored, "
        "2 rejected since its start"
    )
    assert text[2].startswith(
        "predictions: next camera right 0.81 (baseline 0.55), among the first"
    )
    assert text[2].endswith("200 exits since version 3")
    alarms = text[text.index("ALARMS") + 1 :][: ALARMS_SHOWN + 1]
    assert alarms[0] == (
        "60 min ago, version 6: link closed lobby/6 → hall/2: share 0.60, 0.00 since"
    )
    assert alarms[-2].startswith("60 min ago, version 2") and alarms[-1] == ""  # noqa: PT018
    [first] = [k for k, line in enumerate(text) if "CAMERA" in line]
    assert text[first + 1] == f"! {'cam0007':<20} {'stalled':<13} {7:>8} {'7 s':>9}  {REASON}"
    assert text[first + 2].startswith("  cam0000")
    [first] = [k for k, line in enumerate(text) if "FROM" in line]
    assert text[first + 1].startswith("  lobby/1              hall/2               unseen")
    assert (
        text[-3]
        == "lobby/2 -> hall 61 %, in 6 to 10 s; bar 20 %, in view now; leaves the site 20 %"
    )


def test_before_the_first_link_it_says_what_it_waits_for() -> None:
    nothing = "\n".join(lines(SiteState("hq")))
    assert "no status of the daemon has been received yet" in nothing
    assert "nothing learned yet" in nothing
    assert "ALARMS" not in nothing

    inside = msgspec.structs.replace(topology(links=1).links[0], to="lobby/1", relation="visible")
    without = msgspec.structs.replace(NOTHING, links=[inside])
    text = "\n".join(lines(SiteState("hq"), without))
    assert "0 links between views" in text
    assert waiting_for_links(without) in text


def test_a_sender_of_statuses_may_fall_silent() -> None:
    now = 100.0
    site = busy_site(2, lambda: now)
    publish(site, "film", state="ended", reason="the file is at its end")
    publish(site, "daemon", state="running", catching_up={"seconds": 2640.0, "share": 0.63})
    line = "daemon running, catching up, 63 % (44 minutes behind), 0 events"
    assert line in site.daemon_line(None)
    publish(site, "daemon", state="running", warnings=["no camera is called lobbi"])
    assert "running (no camera is called lobbi), 0 events" in site.daemon_line(None)

    now += SILENT_SECONDS_MIN + 1.0
    publish(site, "cam0001", state="running", reason="")
    assert "daemon silent (no status from the daemon for more than 5 s)" in site.daemon_line(None)
    assert cameras(site) == {
        "cam0000": "silent no status from its grabber for more than 5 s",
        "cam0001": "running",
        "film": "ended the file is at its end",
    }


def test_a_camera_without_grabber_and_without_events_for_a_day_is_gone() -> None:
    site, day = SiteState("hq"), OLD_SECONDS
    counters = {
        "here": {"events": 9, "newest": NOW, "alive": True},
        "lately": {"events": 9, "newest": NOW - day + 1},
        "quiet": {"events": 0, "newest": NOW - day + 1},
        "phantom": {"events": 9, "newest": NOW - day - 1},
    }
    names = {"forgotten": {"old": 3}, "renamed": {"before": "after"}}
    publish(site, "daemon", state="running", reason="", cameras=counters, names=names)
    for name in ("old", "before"):
        publish(site, name, state="running", reason="")
    models = [CameraModel("learned", 0.5, NOW - day - 1)]
    model = Model(1.0, 0.1, -60.0, 600.0, [], models)
    bare = msgspec.structs.replace(NOTHING, cameras=[Camera("learned", [])])
    learned = with_rows(bare, model, [])

    assert cameras(site, learned) == {
        "here": ELSEWHERE,
        "lately": ELSEWHERE,
        "quiet": "no grabber",
        "phantom": "gone",
        "learned": "gone",
        "old": "forgotten its events are refused until `camtopod forget --take-back old`",
        "before": "running counts as after",
    }


def test_a_malformed_message_changes_nothing() -> None:
    site = busy_site(1)
    before = lines(site)
    site.on_status("status/cam0000", b"\xc1")
    site.on_prediction("prediction/lobby", b"\xc1")
    publish(site, "daemon", cameras={"cam0000": {"newest": "x"}})
    publish(site, "cam0000", state=None)
    assert lines(site) == before


# --- a terminal ----------------------------------------------------------------------------------


class Terminal:
    """A terminal with a program in it; ``text`` is all its output."""

    def __init__(self, *command: str, columns: int = 100, rows: int = 30) -> None:
        self._fd, inner = pty.openpty()
        self.resize(columns, rows)
        self.process: subprocess.Popen[bytes] = camtopod(
            *command, stdin=inner, stdout=inner, stderr=inner, start_new_session=True
        )
        os.close(inner)
        self.text = ""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        with contextlib.suppress(OSError):  # the program has ended
            while raw := os.read(self._fd, 65536):
                self.text += raw.decode("utf-8", "replace")

    def resize(self, columns: int, rows: int) -> None:
        fcntl.ioctl(self._fd, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def press(self, key: bytes) -> None:
        os.write(self._fd, key)

    def close(self) -> int:
        """Wait for the program's end and return its status."""
        status = self.process.wait(30)
        self._reader.join(5)
        os.close(self._fd)
        return status


def test_in_a_terminal_through_a_restart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    for name in ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)
    endpoint = free_endpoint()
    config = msgspec.structs.replace(
        small_config(tmp_path / "state"), bus=BusSettings(listen=(endpoint,))
    )
    with Daemon(config):
        terminal = Terminal("--connect", endpoint, "watch")
        wait_for(lambda: "daemon running" in terminal.text, "the first screen")
    with Daemon(config) as daemon:
        assert daemon._bus is not None
        daemon._bus.publish_raw("event/yard", b"\xc1", "event")
        wait_for(lambda: "1 rejected" in terminal.text, "word of the daemon that came back")
        terminal.resize(40, 10)
        wait_for(lambda: "the firs…" in terminal.text, "a narrow screen")
        terminal.press(b"xq")
    assert terminal.close() == 0
    assert terminal.text.endswith("\x1b[?25h\x1b[?1049l"), "cursor and screen are as they were"


def test_plain_lines_without_rich_or_a_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with Daemon(small_config(tmp_path / "state")) as daemon:
        assert main(["--connect", daemon.endpoint, "watch", "--once"]) == 0
    assert capsys.readouterr().out.startswith("site site: daemon running, 0 events stored")

    monkeypatch.setitem(sys.modules, "rich.console", None)
    assert not watch.on_screen(lambda rows: [], threading.Event())


def test_one_of_a_kind_is_no_plural() -> None:
    line, *_ = topology_lines(learn_topology([Event("lobby", "exit", 1.0)]))
    assert "1 event, 1 camera, 1 zone, 0 links between views" in line
