"""`camtopod watch`: as lines, on screens of any size, in a real terminal, over daemon restarts."""

from __future__ import annotations

import contextlib
import fcntl
import io
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
from pathlib import Path

import msgspec
import pytest
from rich.console import Console
from serving import camtopod, free_endpoint, small_config, wait_for

from camtopod import codec
from camtopod.cli.commands import watch
from camtopod.cli.commands.watch import lines
from camtopod.cli.terminal import screen
from camtopod.cli.terminal.screen import REASON_ROWS_MAX, drawn
from camtopod.cli.terminal.site_state import (
    ALARMS_SHOWN,
    SILENT_SECONDS,
    SiteState,
    SiteView,
    prediction_line,
)
from camtopod.config.settings import BusSettings
from camtopod.publishers import GONE_SECONDS
from camtopod.records import (
    TOPOLOGY_SCHEMA,
    Alarm,
    Camera,
    CameraModel,
    InView,
    Link,
    Model,
    NextCamera,
    Prediction,
    SelfScore,
    Topology,
    Transit,
    Zone,
)
from camtopod.serve.daemon import Daemon
from camtopod.topology import waiting_for_links

NOW = 1_700_007_200.0
NOTHING = Topology(TOPOLOGY_SCHEMA, "hq", "01J", 9, 1_700_003_600.0, 0, "sha256:0", [], [], [], [])
SCORE = SelfScore(200, 3, 1.25, 0.81, 0.93, 1.75, 0.55)
SIZES = [(200, 60), (120, 30), (119, 24), (80, 24), (60, 20), (34, 12), (20, 6), (5, 3), (1, 1)]
REASON = "the source cannot be opened: [red]nothing listens at this address and port; trying again in 3.5 s"


class Steady:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def shown(topology: Topology | None) -> str:
    return "\n".join(lines(SiteState().view(topology, "hq", NOW)))


def topology(alarms: int = 0, score: SelfScore | None = None, links: int = 0) -> Topology:
    """Return a version with alarms, an hour old each, and links, the last one the busiest."""
    listed = [
        Alarm(
            k,
            1_700_003_600.0,
            "link_closed",
            f"lobby/{k}->hall/2",
            "share 0.60 until 5, 0.00 since",
        )
        for k in range(alarms)
    ]
    transit = Transit(7.8, 8.1, 1.9, -6.2, 7.9, 10.4)
    found = [
        Link(f"lobby/{k}", "hall/2", "unseen", 0.4, float(k), transit, 0.0, 0.1)
        for k in range(links)
    ]
    return msgspec.structs.replace(NOTHING, alarms=listed or None, score=score, links=found)


def told(board: SiteState, name: str, **status: object) -> None:
    board.on_status(f"status/{name}", msgspec.msgpack.encode(status))


def full(cameras: int, steady: Steady | None = None) -> SiteState:
    """Return a site with cameras, one in ten of them with a problem, a daemon, and predictions."""
    board = SiteState(steady or Steady())
    counts = {f"cam{k:04}": {"events": k, "newest": NOW - k, "alive": True} for k in range(cameras)}
    told(
        board,
        "daemon",
        state="running",
        reason="",
        cameras=counts,
        events={"stored": 77},
        rejects={"malformed": 2},
    )
    for k in range(cameras):
        well = k % 10 != 7
        told(
            board,
            f"cam{k:04}",
            state="running" if well else "stalled",
            reason="" if well else REASON,
        )
    following = [
        NextCamera("hall", "hall/2", 0.61, 6.2, 7.9, 10.4),
        NextCamera("bar", "bar/1", 0.2, -3.0, 1.0, -1.0),
    ]
    for k in range(3):
        said = Prediction("lobby", f"lobby/{k}", NOW - 3.0 + k, "17", 9, 0.2, following)
        board.on_prediction("prediction/lobby", codec.to_msgpack(said))
    return board


def on_screen(view: SiteView, width: int, height: int, words: str = "") -> list[str]:
    """Return the text on the screen."""
    console = Console(
        file=io.StringIO(), width=width, height=height, color_system=None, legacy_windows=False
    )
    with console.capture() as capture:
        console.print(drawn(view, width, height, words), height=height)
    return [line.rstrip() for line in capture.get().splitlines()]


# --- lines ---------------------------------------------------------------------------------------


def test_the_newest_alarms_are_shown_newest_first() -> None:
    text = shown(topology(ALARMS_SHOWN + 2, None))
    assert (
        "60 min ago, version 6: link_closed lobby/6->hall/2, share 0.60 until 5, 0.00 since" in text
    )
    assert text.index("lobby/6->") < text.index("lobby/2->")
    assert "lobby/1->" not in text


def test_who_sees_somebody_now_is_said_first() -> None:
    """Views that see the object now come first, if likely; passages of one view are added up."""
    in_view = [
        InView("hall", "1", NOW, 0.5),
        InView("stairs", "2", NOW, 0.1),
        InView("hall", "3", NOW, 0.25),
    ]
    said = Prediction("lobby", "lobby/1", NOW, "17", 9, 1.0, [], [], in_view)
    assert prediction_line(said) == "lobby/1 -> now in view of hall 0.75"


def test_the_score_is_shown_beside_its_baseline() -> None:
    text = shown(topology(0, SCORE))
    assert (
        "next camera right 0.81 (baseline 0.55), among the first three 0.93, log loss 1.25 (baseline 1.75)"
        in text
    )
    assert "200 exits since version 3" in text


def test_without_either_nothing_is_said() -> None:
    assert "ALARMS" not in shown(topology(0, None)) + shown(None)
    assert "next camera right" not in shown(topology(0, None)) + shown(None)


def test_all_of_it_as_lines() -> None:
    text = lines(full(9).view(topology(links=2), "hq", NOW))
    assert text[0] == "site hq: daemon running, 77 events stored, 2 rejected since its start"
    assert f"{'cam0007':<20} {'stalled':<11} {7:>8} {'7 s':>9}  {REASON}" in text
    assert any(line.startswith("lobby/1              hall/2               unseen") for line in text)
    assert text[-3] == "lobby/2 -> hall/2 0.61 in 6 to 10 s, bar/1 0.20 already in view"


def test_a_daemon_that_is_behind_says_how_far() -> None:
    board = SiteState(Steady())
    told(board, "daemon", state="running", catching_up={"seconds": 2640.0, "share": 0.63})
    assert (
        "daemon running, catching up, 63% (44 minutes behind)"
        in lines(board.view(None, "hq", NOW))[0]
    )


def test_links_are_those_between_views_and_without_one_it_says_what_it_waits_for() -> None:
    inside = msgspec.structs.replace(topology(links=1).links[0], to="lobby/1", relation="visible")
    without = msgspec.structs.replace(NOTHING, links=[inside])
    text = shown(without)
    assert "0 cameras, 0 zones, 0 links between views" in text
    assert waiting_for_links(without) in text
    assert "1 link between views" in shown(topology(links=1))


def test_where_views_overlap_no_time_is_negative() -> None:
    site = topology(links=1)
    early = msgspec.structs.replace(site.links[0].transit, q50=-4.53)
    site = msgspec.structs.replace(
        site, links=[msgspec.structs.replace(site.links[0], transit=early)]
    )
    assert "overlap, 4.5 s before" in shown(site)


def test_who_probably_returns_to_the_view_it_left_comes_back() -> None:
    following = [NextCamera("lobby", "lobby/2", 0.6, 1.0, 2.0, 3.0)]
    said = Prediction("lobby", "lobby/1", NOW, "17", 9, 0.4, following)
    assert prediction_line(said) == "lobby/1 -> back to lobby/2 0.60 in 1 to 3 s"


def test_who_is_not_heard_any_more_is_silent_whatever_was_said_last() -> None:
    steady = Steady()
    board = full(2, steady)
    told(board, "film", state="ended", reason="the file is at its end")
    steady.now += SILENT_SECONDS + 1.0
    told(board, "cam0001", state="running", reason="")
    view = board.view(None, "hq", NOW)
    assert (view.state, view.reason) == (
        "silent",
        "no status for 6 s; what is shown below may be outdated",
    )
    states = {camera.name: (camera.state, camera.reason) for camera in view.cameras}
    assert states["cam0000"] == ("silent", "no status for 6 s")
    assert states["cam0001"] == ("running", "")
    assert states["film"][0] == "ended"


def test_a_camera_without_grabber_and_without_events_for_a_day_is_gone() -> None:
    board, day = SiteState(Steady()), GONE_SECONDS
    counts = {
        "here": {"events": 9, "newest": NOW, "alive": True},
        "quiet": {"events": 9, "newest": NOW - day - 1, "alive": True},
        "lately": {"events": 9, "newest": NOW - day + 1},
        "phantom": {"events": 9, "newest": NOW - day - 1},
    }
    told(board, "daemon", state="running", reason="", cameras=counts)
    states = {one.name: one.state for one in board.view(None, "hq", NOW).cameras}
    assert states == {
        "here": "unknown",
        "quiet": "unknown",
        "lately": "no grabber",
        "phantom": "gone",
    }

    # One that was learned of, and has sent nothing since the daemon's start.
    models = [CameraModel("learned", 0.5, NOW - day - 1)]
    model = Model(1.0, 0.1, -60.0, 600.0, [], models)
    site = msgspec.structs.replace(NOTHING, cameras=[Camera("learned", [])], model=model)
    [learned] = [one for one in board.view(site, "hq", NOW).cameras if one.name == "learned"]
    assert (learned.state, learned.wrong) == ("gone", False)


def test_what_was_done_with_a_name_is_said() -> None:
    board = SiteState(Steady())
    names = {"forgotten": {"old": 3}, "renamed": {"before": "after"}}
    told(board, "daemon", state="running", reason="", names=names)
    for name in ("old", "before", "after"):
        told(board, name, state="running", reason="")
    cameras = {one.name: one for one in board.view(None, "hq", NOW).cameras}
    assert cameras["old"].state == "forgotten"
    assert "forget --take-back old" in cameras["old"].reason
    assert (cameras["before"].state, cameras["before"].reason) == ("running", "counts as after")
    assert cameras["after"].reason == ""


def test_an_operators_word_is_shown_with_its_link() -> None:
    site = topology(links=1)
    wrong = msgspec.structs.replace(site.links[0], operator="wrong")
    assert "s, said to be wrong" in shown(msgspec.structs.replace(site, links=[wrong]))
    assert "said to be" not in shown(site)


def test_what_cannot_be_read_changes_nothing() -> None:
    board = full(1)
    before = board.view(None, "hq", NOW)
    board.on_status("status/cam0000", b"\xc1")
    board.on_prediction("prediction/lobby", b"\xc1")
    for odd in (
        {"cameras": 3},
        {"cameras": {"cam0000": 3}},
        {"cameras": {"cam0000": {"newest": "x"}}},
        {"events": None},
        {"rejects": [1]},
        {"rejects": {"malformed": "x"}},
        {"state": 3},
    ):
        told(board, "daemon", **odd)
    told(board, "cam0000", state=None)
    assert board.view(None, "hq", NOW) == before


# --- a screen ------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("cameras", [0, 1, 1000])
def test_it_fits_any_terminal(size: tuple[int, int], cameras: int) -> None:
    text = on_screen(full(cameras).view(topology(9, SCORE, 300), "hq", NOW), *size, "warning: x")
    assert len(text) <= size[1]
    assert max(map(len, text), default=0) <= size[0]
    text = on_screen(SiteState().view(None, "hq", NOW), *size)
    assert len(text) <= size[1]


def test_everything_is_there_on_a_large_one() -> None:
    text = "\n".join(
        on_screen(
            full(9).view(topology(2, SCORE, 3), "hq", NOW), 160, 40, "warning: the disk is full"
        )
    )
    for said in (
        "daemon running, 77 events stored",
        "version 9, 0 events",
        "next camera right 0.81",
        "! 60 min ago, version 1: link_closed lobby/1->hall/2",
        "warning: the disk is full",
        "cam0007  ! stalled",
        "the source cannot be opened: [red]",
        "0.40  7.9 (-6.2 to 10.4) s",
        "1 s ago  lobby/2 -> hall/2 0.61 in 6 to 10 s, bar/1 0.20",
    ):
        assert said in text
    assert REASON in " ".join(" ".join(on_screen(full(9).view(None, "hq", NOW), 90, 40)).split()), (
        "the whole of it"
    )


def test_what_it_waits_for_is_whole_on_a_narrow_one() -> None:
    site = msgspec.structs.replace(
        NOTHING,
        cameras=[Camera(name, [f"{name}/1"]) for name in ("left", "right")],
        zones=[Zone(f"{name}/1", name, 90, 90) for name in ("left", "right")],
    )
    text = on_screen(full(4).view(site, "hq", NOW), 50, 30)
    assert waiting_for_links(site) in " ".join(text)
    assert "since its start" in " ".join(text), "nor is the daemon's line cut"


def test_of_many_cameras_those_that_are_not_well_come_first() -> None:
    view = full(1000).view(None, "hq", NOW)
    text = on_screen(view, 100, 50)
    heading = next(k for k, line in enumerate(text) if line.startswith("CAMERA"))
    rows = [line for line in text[heading + 1 :] if line.startswith("cam")]
    assert len(rows) > 10
    assert all("! stalled" in row for row in rows)
    [more] = [line for line in text if line.startswith("and ")]
    assert more.split() == ["and", str(1000 - len(rows)), "more", str(100 - len(rows)), "faulty"]
    assert len(text) - heading <= REASON_ROWS_MAX * len(rows) + 20
    quiet = [camera for camera in view.cameras if not camera.wrong]
    text = on_screen(view._replace(cameras=quiet), 100, 50)
    assert [line.split()[0] for line in text if line.startswith("cam")][:3] == [
        "cam0000",
        "cam0001",
        "cam0002",
    ]
    assert any(re.fullmatch(r"and \d+ more +ok", line) for line in text)


# --- a terminal ----------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def _usual_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    for name in ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)


class Terminal:
    """A terminal with a program in it; ``text`` is all its output."""

    def __init__(self, *command: str, columns: int = 100, rows: int = 30) -> None:
        self._fd, inner = pty.openpty()
        self.resize(columns, rows)
        self.began = time.monotonic()
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

    def close(self) -> int:
        """Interrupt the program and return its status."""
        self.process.send_signal(signal.SIGINT)
        status = self.process.wait(30)
        self._reader.join(5)
        os.close(self._fd)
        return status


def test_in_a_terminal_through_a_restart(tmp_path: Path) -> None:
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
    assert terminal.close() == 0
    seconds = time.monotonic() - terminal.began
    draws = terminal.text.count("\x1b[H")
    assert 3 <= draws <= 4 * seconds + 2
    assert terminal.text.endswith("\x1b[?25h\x1b[?1049l"), "cursor and screen are as they were"


def test_plain_lines_where_it_is_not_installed_or_not_wanted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Daemon(small_config(tmp_path / "state")) as daemon:
        terminal = Terminal("--connect", daemon.endpoint, "watch", "--plain", columns=30)
        wait_for(lambda: terminal.text.count("PREDICTIONS") >= 2, "two pictures")
        assert terminal.close() == 0
    assert "site site: daemon running, 0 e\r\n" in terminal.text, "cut at the width"
    assert "\x1b[?1049h" not in terminal.text
    stop = threading.Event()
    assert not watch._on_screen(lambda: SiteState().view(None, "hq", NOW), stop), (
        "standard output is no terminal"
    )
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setattr(screen, "Console", lambda: Console(force_terminal=True, file=io.StringIO()))
    assert not watch._on_screen(lambda: SiteState().view(None, "hq", NOW), stop)
    for name in [
        name
        for name in sys.modules
        if name == "camtopod.cli.terminal.screen" or name.partition(".")[0] == "rich"
    ]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rich", None)
    assert not watch._on_screen(lambda: SiteState().view(None, "hq", NOW), stop)
