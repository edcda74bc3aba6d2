"""`camtopod grab` of one camera, with a fake grabber."""

from __future__ import annotations

import contextlib
import errno
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import pytest
import serving
from fake_bus_daemon import running
from serving import T0, free_endpoint, small_config, wait_for

from camtopod import files
from camtopod.cli.cameras.heartbeat import HeartbeatReceiver, state_of
from camtopod.cli.main import main
from camtopod.codec import event_from_json
from camtopod.config.config_file import load
from camtopod.records import Event
from camtopod.serve import bus as buses
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox.publisher import SpoolPublisher
from camtopod.vision import grabber as grabbers
from camtopod.vision.settings import VisionSettings
from camtopod.vision.source.recorded import SourceError

EVENTS = [Event("lobby", "entry", T0 + n, 0.5, 0.25, str(n)) for n in range(20)]


class FakeGrabber:
    """Yields `EVENTS`, with a heartbeat after each."""

    made: ClassVar[list[FakeGrabber]] = []
    error: ClassVar[OSError | None] = None
    overdue_seconds: ClassVar[float] = 0.0
    between: ClassVar[Callable[[], None]] = staticmethod(lambda: None)

    def __init__(self, camera: str, source: str, **options: Any) -> None:
        self.camera, self.source, self.options = camera, source, options
        self.state, self.reason, self.closed = "connecting", "rtsp://admin:p@ss@h is slow", False
        FakeGrabber.made.append(self)

    def events(self) -> Iterator[Event | None]:
        if self.error is not None:
            raise self.error
        self.state, self.reason = "running", ""
        for event in EVENTS:
            yield event
            FakeGrabber.between()
            yield None
        self.state = "ended"

    def statistics(self) -> dict[str, int | float]:
        figures = dict.fromkeys(
            ("frames_dropped", "frames_analysed", "blind_seconds", "entries", "exits"), 0
        )
        return {"frames": 7, **figures}

    def close(self) -> None:
        self.closed = True


@pytest.fixture(autouse=True)
def fake(monkeypatch: pytest.MonkeyPatch) -> type[FakeGrabber]:
    monkeypatch.setattr(grabbers, "Grabber", FakeGrabber)
    monkeypatch.setattr(FakeGrabber, "made", [])
    monkeypatch.setattr(FakeGrabber, "error", None)
    return FakeGrabber


def grab_to(endpoint: str, folder: Path) -> list[str]:
    """Return the arguments for the camera's events onto a bus."""
    grab = ["grab", "--camera", "lobby", "x.mp4", "--state", str(folder)]
    return ["--connect", endpoint, *grab]


@pytest.mark.parametrize(("seconds", "told"), [(0.4, 1), (0.6, 0)])
def test_more_events_than_people_make_are_said_once(
    seconds: float,
    told: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """As rain and snow do."""
    rain = [Event("yard", "exit", n * seconds, 0.5, 0.5, str(n)) for n in range(300)]
    monkeypatch.setattr(f"{__name__}.EVENTS", rain)
    assert main(["grab", "--camera", "yard", "rain.mp4", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().err
    assert said.count("camera yard makes more than 120 events a minute") == told
    assert said.count("[cameras.yard]") == told


def test_lines_to_a_file_and_to_standard_output(
    tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    out = tmp_path / "e.jsonl"
    arguments = ["grab", "--camera", "lobby", "x.mp4"]
    arguments += ["--start", "5", "--realtime", "--out"]
    assert main([*arguments, str(out)]) == 0
    assert [event_from_json(line) for line in out.read_bytes().splitlines()] == EVENTS
    made = FakeGrabber.made[0]
    assert (made.source, made.closed) == ("x.mp4", True)
    assert made.options["file_options"] == (5.0, True)
    for name in ("-", "/proc/self/fd/1"):
        assert main([*arguments, name]) == 0
        assert capfdbinary.readouterr().out == out.read_bytes()


@pytest.mark.parametrize("failure", ["a full disk", "no picture"])
def test_an_older_file_stays_if_its_successor_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failure: str
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    out = tmp_path / "e.jsonl"
    out.write_text("of before")
    if failure == "a full disk":
        monkeypatch.setattr(files.os, "fsync", full)
    else:
        monkeypatch.setattr(FakeGrabber, "events", lambda _: iter([]))
    assert main(["grab", "--camera", "lobby", "x.mp4", "--out", str(out)]) in (1, 66)
    assert out.read_text() == "of before"
    assert [*tmp_path.iterdir()] == [out]


def test_a_camera_that_stalls_is_a_warning(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def events(grabber: FakeGrabber) -> Iterator[None]:
        for grabber.state, grabber.reason in (("running", ""), ("stalled", "no picture for 9 s")):
            yield None

    monkeypatch.setattr(FakeGrabber, "events", events)
    assert main(["--log-level", "warning", "grab", "--camera", "a", "x", "--out", "-"]) == 0
    err = capsys.readouterr().err
    assert "warning: camera a is stalled: no picture for 9 s" in err
    assert "running" not in err


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (FileNotFoundError(2, "No such file or directory", "x.mp4"), "cannot read x.mp4: No such"),
        (SourceError("x.mp4: not a video"), "x.mp4: not a video"),
    ],
)
def test_a_file_that_cannot_be_read(
    error: OSError, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    FakeGrabber.error = error
    assert main(["grab", "--camera", "lobby", "x.mp4", "--out", "-"]) == 66
    assert said in capsys.readouterr().err
    assert FakeGrabber.made[0].closed


def test_usage() -> None:
    for line in ("", "x.mp4", "--camera lobby", "--camera a x --start inf"):
        assert main(["grab", *line.split()]) == 2
    milliseconds = "1700000000000"
    assert main(["grab", "--camera", "a", "x", "--start", milliseconds, "--out", "-"]) == 2
    assert main(["grab", "--out", "-"]) == 2


def test_a_camera_s_own_settings_and_another_source(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, out = tmp_path / "c.toml", str(tmp_path / "e.jsonl")
    config.write_text(
        "[vision]\nanalysed_fps = 5\n[cameras.lobby]\nmin_height = 0.2\n"
        "[cameras.hall]\nsource_file = 'nowhere'\nanalysed_fps = 9\n"
    )
    grab = ["--config", str(config), "grab", "--out", out, "--camera"]
    for camera in ("lobby", "hall", "other"):
        assert main([*grab, camera, f"{camera}.mp4"]) == 0
    lobby, hall, other = FakeGrabber.made
    assert [made.source for made in FakeGrabber.made] == ["lobby.mp4", "hall.mp4", "other.mp4"]
    assert lobby.options["settings"] == VisionSettings(analysed_fps=5.0, min_height=0.2)
    assert hall.options["settings"] == VisionSettings(analysed_fps=9.0)
    assert other.options["settings"] == VisionSettings(analysed_fps=5.0)

    # Without a source on the command line one in the configuration is needed.
    capsys.readouterr()
    assert main([*grab, "lobby"]) == 2
    assert "lobby has no source: give SOURCE, or a --config with a source in [cameras.lobby]" in (
        capsys.readouterr().err
    )
    assert main([*grab, "hall"]) == 66
    assert main(["--config", str(config), "grab"]) == 78
    assert f"{config}:3: cameras.lobby: source is missing" in capsys.readouterr().err


def test_no_bus_and_no_state(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("camtopod.cli.commands.grab.DRAIN_SECONDS", 0.05)
    config = tmp_path / "c.toml"
    config.write_text('[bus]\nconnect = ["tcp/127.0.0.1:1"]\nconnect_seconds = 0.05\n')
    grab = ["--config", str(config), "grab", "--camera", "lobby", "x.mp4", "--state"]

    assert main([*grab, str(tmp_path)]) == 69
    err = capsys.readouterr().err
    assert "is `camtopod run` running there?" in err
    assert "20 events are not stored" in err

    (tmp_path / "file").write_text("")
    assert main([*grab, str(tmp_path / "file" / "state")]) == 74
    assert "cannot write the state directory" in capsys.readouterr().err


def test_every_event_reaches_the_daemon_and_the_status_tells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    droppable: list[bool | None] = []
    really_publish = buses.Bus.publish

    def publish(bus: buses.Bus, key: str, message: Any, schema: str, *given: bool | None) -> None:
        if key == "status/lobby":
            droppable.extend(given)
        really_publish(bus, key, message, schema, *given)

    monkeypatch.setattr(buses.Bus, "publish", publish)
    with Daemon(small_config(tmp_path / "daemon")) as daemon:
        client = buses.dial(small_config(tmp_path, daemon.endpoint))
        said: list[dict[str, Any]] = []
        client.subscribe("status/lobby", lambda key, raw: said.append(msgspec.msgpack.decode(raw)))
        # The daemon has the subscription once it has answered.
        assert client.query("status/daemon", seconds=serving.WAIT_SECONDS, one=True)
        arguments = grab_to(daemon.endpoint, tmp_path)
        assert main(arguments) == 0
        assert daemon.status().events.stored == len(EVENTS)
        last = {"camera": "lobby", "frames": 7, "published": len(EVENTS), "waiting": 0}
        wait_for(lambda: bool(said) and {**said[-1], **last} == said[-1], "the last status")
        assert said[-1]["state"] == "ended"
        assert droppable[-1] is False
        assert droppable.count(False) == 1, "an earlier one would keep it out"
        assert (said[-1]["status_seconds"], daemon.status().status_seconds) == (1.0, 0.1)
        assert main(arguments) == 0
        assert daemon.status().events.stored == 2 * len(EVENTS), "the spool's count goes on"
        client.close()


def test_the_last_status_of_a_film_that_is_stored_at_once_is_published(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The thread that connects may not have gone on yet."""
    over = threading.Event()
    really_attach = SpoolPublisher.attach

    def attach(publisher: SpoolPublisher, *given: Any) -> None:
        really_attach(publisher, *given)
        over.wait(serving.WAIT_SECONDS)

    monkeypatch.setattr(SpoolPublisher, "attach", attach)
    with Daemon(small_config(tmp_path / "daemon")) as daemon:
        client = buses.dial(small_config(tmp_path, daemon.endpoint))
        said: list[dict[str, Any]] = []
        client.subscribe("status/lobby", lambda key, raw: said.append(msgspec.msgpack.decode(raw)))
        assert client.query("status/daemon", seconds=serving.WAIT_SECONDS, one=True)
        assert main(grab_to(daemon.endpoint, tmp_path)) == 0
        wait_for(lambda: bool(said) and said[-1]["state"] == "ended", "the last status")
        over.set()
        client.close()


@pytest.mark.parametrize(
    ("overdue", "states"), [(0.0, ["running", "ended"]), (1.0, ["connecting", "ended"])]
)
def test_heartbeats_show_progress_unless_opencv_is_overdue(
    overdue: float, states: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    receiver = HeartbeatReceiver()
    heard: list[str] = []
    monkeypatch.setattr(FakeGrabber, "overdue_seconds", overdue)
    monkeypatch.setenv("NOTIFY_SOCKET", receiver.address)

    def hear() -> None:
        heard.extend(state for state, _ in [state_of(receiver.lines()) or ("", "")] if state)

    monkeypatch.setattr(FakeGrabber, "between", staticmethod(hear))
    with Daemon(small_config(tmp_path / "daemon")) as daemon:
        restarted = ["--restarts", "2", "--last-end", "failed"]
        assert main([*grab_to(daemon.endpoint, tmp_path), *restarted]) == 0
    hear()
    assert heard == states
    receiver.close()


def test_a_supervised_file_waits_for_the_daemon_at_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If it ended as failed, it would be started again, and all events would be duplicated."""
    monkeypatch.setattr("camtopod.cli.commands.grab.DRAIN_SECONDS", 0.05)
    receiver = HeartbeatReceiver()
    monkeypatch.setenv("NOTIFY_SOCKET", receiver.address)
    said = []
    really_wait_stored = SpoolPublisher.wait_stored

    def wait_stored(publisher: SpoolPublisher, seconds: float, most: int = 0) -> bool:
        said.append(state_of(receiver.lines()))
        if len(said) == 4:
            daemon.start()
        if len(said) >= 4:
            seconds = serving.WAIT_SECONDS
        return really_wait_stored(publisher, seconds, most)

    monkeypatch.setattr(SpoolPublisher, "wait_stored", wait_stored)
    with contextlib.ExitStack() as stack:
        meeting = stack.enter_context(buses.open_daemon_session(small_config(tmp_path)))
        daemon = Daemon(small_config(tmp_path / "daemon", meeting.endpoint))
        stack.callback(daemon.stop)
        assert main(grab_to(meeting.endpoint, tmp_path)) == 0
        assert daemon.status().events.stored == len(EVENTS)
    assert ("ended", "waiting for the daemon to store 20 events") in said
    receiver.close()


def test_events_wait_in_the_spool_while_the_bus_is_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The daemon starts after the first events."""
    said: list[str] = []

    def is_said(text: str) -> bool:
        said.append(capsys.readouterr().err)
        return text in "".join(said)

    endpoint = free_endpoint()
    config = small_config(tmp_path / "daemon")
    bus = msgspec.structs.replace(config.bus, listen=(endpoint,))
    daemon = Daemon(msgspec.structs.replace(config, bus=bus))
    count = 0

    def between() -> None:
        nonlocal count
        count += 1
        if count == 10:
            wait_for(lambda: is_said("events are kept in the spool"), "the warning")
            daemon.start()
        if count == 19:
            wait_for(lambda: daemon.status().events.stored >= 10, "the events of before")

    monkeypatch.setattr(FakeGrabber, "between", staticmethod(between))
    path = tmp_path / "c.toml"
    path.write_text(
        f'[bus]\nconnect = ["{endpoint}"]\nconnect_seconds = 0.2\n[cameras.lobby]\nsource = "rtsp://h/x"\n'
    )
    assert main(["--config", str(path), "grab", "--camera", "lobby", "--state", str(tmp_path)]) == 0
    assert daemon.status().events.stored == len(EVENTS)
    assert FakeGrabber.made[0].source == "rtsp://h/x"
    assert is_said("connected to the daemon again")
    daemon.stop()


def test_a_camera_of_two_sites_delivers_to_both_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("camtopod.cli.commands.grab.DRAIN_SECONDS", 0.05)
    ends = {"north": free_endpoint(), "south": free_endpoint()}
    path = tmp_path / "c.toml"
    path.write_text(
        f'[site]\nname = "north"\n[bus]\nconnect = ["{ends["north"]}"]\nconnect_seconds = 0.2\n'
        f'[sites.south]\nconnect = ["{ends["south"]}"]\n'
        '[cameras.lobby]\nsource = "x.mp4"\nsites = ["north", "south"]\n'
        "[limits]\nstatus_seconds = 0.001\n"
    )
    grab = ["--config", str(path), "grab", "--camera", "lobby", "--state", str(tmp_path / "box")]
    said: dict[str, dict[str, Any]] = {}
    with contextlib.ExitStack() as stack:
        north = stack.enter_context(running(tmp_path / "north", ends["north"], site="north"))
        daemons = [north]
        counts = Counter[Daemon]()

        def between() -> None:
            for daemon in daemons:
                counts[daemon] += 1
                wait_for(lambda one=daemon: one.status().events.stored >= counts[one], "the event")

        monkeypatch.setattr(FakeGrabber, "between", staticmethod(between))
        assert main(grab) == 69
        assert (
            "20 events are not stored: is `camtopod run` running for site south?"
            in capsys.readouterr().err
        )

        monkeypatch.setattr("camtopod.cli.commands.grab.DRAIN_SECONDS", serving.WAIT_SECONDS)
        south = stack.enter_context(running(tmp_path / "south", ends["south"], site="south"))
        daemons.append(south)
        for site in ends:
            bus = stack.enter_context(buses.dial(load(path).at(site)))
            bus.subscribe(
                "status/lobby",
                lambda _, raw, site=site: said.update({site: msgspec.msgpack.decode(raw)}),
            )
            assert bus.query("status/daemon", seconds=serving.WAIT_SECONDS, one=True)
        assert main(grab) == 0
        assert south.status().events.stored == north.status().events.stored == 2 * len(EVENTS)
        wait_for(lambda: said.keys() == ends.keys(), "the statuses")
    assert [(said[site]["owner"], said[site]["sites"]) for site in ends] == [
        ("north", ["north", "south"])
    ] * 2
