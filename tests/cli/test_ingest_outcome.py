"""`camtopod ingest` beside real daemons: which daemon takes an event, and the reported outcome."""

from __future__ import annotations

import contextlib
import re
import sqlite3
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
import pytest
from fake_bus_daemon import running
from msgspec.structs import replace
from serving import T0, free_endpoint, small_config, wait_for

from camtopod import codec
from camtopod.cli import exits
from camtopod.cli.commands import ingest as ingest_command
from camtopod.cli.main import main
from camtopod.config import Limits
from camtopod.config.settings import SiteSettings
from camtopod.records import Event
from camtopod.serve.bus import Bus, open_daemon_session
from camtopod.serve.daemon import Daemon
from camtopod.serve.ingest import backlogs
from camtopod.serve.outbox import SiteDelivery, SpoolPublisher, publisher
from camtopod.serve.outbox.spool_files import open_ingest_spool


@contextlib.contextmanager
def site(folder: Path, name: str, now: float = T0 + 100_000.0, **limits: float) -> Iterator[Daemon]:
    """Run a daemon of a site, with a state directory of its own."""
    config = small_config(folder / name, **limits)
    config = msgspec.structs.replace(config, site=SiteSettings(name))
    with Daemon(config, clock=lambda: now) as daemon:
        yield daemon


def ingest(daemon: Daemon, folder: Path, file: Path, *more: str) -> int:
    where = ["--connect", daemon.endpoint, "--site", daemon.bus.site]
    return main([*where, "ingest", "jsonl", str(file), "--state", str(folder / "here"), *more])


def lines(path: Path, events: list[Event]) -> Path:
    path.write_bytes(b"".join(codec.to_json(event) + b"\n" for event in events))
    return path


def stored(folder: Path, name: str) -> int:
    """Return the number of events in the journal of a daemon."""
    with contextlib.closing(sqlite3.connect(folder / name / "journal.db")) as journal:
        found = journal.execute("SELECT COUNT(*) FROM entry WHERE kind = 'event'").fetchone()
        return int(found[0])


def test_each_of_two_sites_has_its_own_events_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = lines(tmp_path / "a.jsonl", [Event("lobby", "entry", T0 + n) for n in range(60)])
    second = lines(tmp_path / "b.jsonl", [Event("lobby", "entry", T0 + 0.5)])

    with site(tmp_path, "a") as a, site(tmp_path, "b") as b:
        assert ingest(a, tmp_path, first) == 0
        assert ingest(b, tmp_path, second) == 0
        assert ingest(a, tmp_path, second) == 0

    assert (stored(tmp_path, "a"), stored(tmp_path, "b")) == (61, 1)
    assert "60 events stored\n" in capsys.readouterr().err


def test_what_became_of_the_events_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # One camera: here others would not be waited for.
    times = [*range(120), 20_000]
    events = len(times)
    recording = lines(tmp_path / "a.jsonl", [Event("lobby", "entry", T0 + t) for t in times])
    old = lines(
        tmp_path / "old.jsonl", [Event("lobby", "entry", T0 - 50_000.0 - n) for n in range(20)]
    )
    both = lines(
        tmp_path / "both.jsonl",
        [Event("lobby", "entry", T0 + 20_003.0), Event("lobby", "exit", T0 - 9e4)],
    )
    later = [Event("lobby", "exit", T0 + 20_004.0 + n / 8) for n in range(4)]
    some = lines(tmp_path / "some.jsonl", [*later, Event("lobby", "exit", T0 + 300_000.0)])
    early = lines(tmp_path / "early.jsonl", [Event("hall", "entry", T0 + 300_000.0)])

    with site(tmp_path, "a") as daemon:
        assert ingest(daemon, tmp_path, recording) == 0
        assert f"{events} events stored\n" in capsys.readouterr().err
        assert ingest(daemon, tmp_path, recording) == 0
        before = f"0 events stored, {events} had been ingested before\n"
        assert before in capsys.readouterr().err
        assert ingest(daemon, tmp_path, old) == 0
        assert "20 events stored, 20 of them late" in capsys.readouterr().err
        assert ingest(daemon, tmp_path, both) == 0
        assert "2 events stored, 1 of them late" in capsys.readouterr().err
        assert ingest(daemon, tmp_path, early) == 1
        assert "1 events stored, 1 of them refused" in capsys.readouterr().err
        assert ingest(daemon, tmp_path, some) == 1, "a fifth of them"
        assert "5 events stored, 1 of them refused" in capsys.readouterr().err
        assert ingest(daemon, tmp_path, recording, "--anew") == 0
        assert f"{events} events stored, {events - 1} of them late" in capsys.readouterr().err
        assert daemon.status().events.stored == 2 * events + 26

        # A file that has grown, and one that only begins in the same way.
        more = [Event("lobby", "exit", T0 + 20_010.0 + n) for n in range(4)]
        grown = lines(recording, [Event("lobby", "entry", T0 + t) for t in times] + more[:2])
        assert ingest(daemon, tmp_path, grown) == 0
        assert f"2 events stored, {events} had" in capsys.readouterr().err
        with grown.open("ab") as file:
            file.write(codec.to_json(more[2]) + b"\n")
        assert ingest(daemon, tmp_path, grown) == 0
        assert f"1 events stored, {events + 2} had" in capsys.readouterr().err
        other = lines(tmp_path / "c.jsonl", [Event("lobby", "entry", T0), more[3]])
        assert ingest(daemon, tmp_path, other) == 0
        assert "2 events stored, 1 of them late" in capsys.readouterr().err


@pytest.mark.parametrize("order", ["by time", "by camera", "newest first, all twice"])
def test_a_recording_is_stored_whole_and_none_of_an_ordered_one_is_late(
    order: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """All of it is in the spool when its delivery begins, and nothing of it is published.

    What comes twice counts once, and a stamp that the lines around it contradict is left out.
    """
    events = [Event(f"c{n % 50}", "entry", T0 + 3.0 * n, track=str(n)) for n in range(4_000)]
    if order == "by camera":
        events.sort(key=lambda event: event.camera)
    written = events
    if order == "newest first, all twice":
        wrong = Event("c7", "entry", T0 + 9e6, track="wrong")
        written = [event for event in reversed(events) for _ in range(2)]
        written.insert(3_000, wrong)
    waiting: list[int] = []
    published: list[str] = []
    monkeypatch.setattr(backlogs, "SETTLE_SECONDS", 5.0)  # as outside of tests

    class Told(SpoolPublisher):
        """A publisher that notes how many events wait when the delivery begins."""

        def attach(self, bus: Bus) -> None:
            waiting.append(self.waiting)
            super().attach(bus)

    monkeypatch.setattr(ingest_command, "SpoolPublisher", Told)
    with site(tmp_path, "a") as daemon:
        daemon.bus.subscribe("event/*", lambda key, content: published.append(key))
        assert ingest(daemon, tmp_path, lines(tmp_path / "a.jsonl", written)) == 0
        status = daemon.status().events

    assert waiting == [len(events)]
    assert published == []
    assert stored(tmp_path, "a") == status.stored == len(events)
    said = capsys.readouterr().err
    if order == "newest first, all twice":
        assert "4000 of 8001 lines are repeats, counted once" in said
        assert "the lines of c7 around it contradict by more than a day" in said
    else:
        assert "4000 events stored\n" in said, "none of them late"


@pytest.mark.parametrize("newest_first", [False, True])
def test_a_file_that_grows_keeps_its_numbers_though_its_last_stamp_was_wrong(
    newest_first: bool, tmp_path: Path
) -> None:
    events = [Event("lobby", "entry", T0 + 10.0 * n, track=str(n)) for n in range(60)]
    if newest_first:
        events.reverse()
    events += [Event("hall", "entry", T0 - 9e6 + n, track=str(n)) for n in range(20)]
    wrong = Event("lobby", "entry", T0 - 9e6, track="wrong")
    later = [replace(event, t=event.t + 9.0, track=f"{event.track}b") for event in events[:4]]
    path = lines(tmp_path / "a.jsonl", [*events, wrong])

    with site(tmp_path, "a") as daemon:
        ingest(daemon, tmp_path, path)
        with path.open("ab") as file:
            file.writelines(codec.to_json(event) + b"\n" for event in later)
        ingest(daemon, tmp_path, path)

    assert stored(tmp_path, "a") == len(events) + 1 + len(later)


def test_cameras_too_many_end_it_and_left_events_of_them_hold_nothing_up(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also beside another process, which has a spool of its own."""
    right = lines(tmp_path / "a.jsonl", [Event("lobby", "entry", T0 + n) for n in range(10)])
    wrong = lines(tmp_path / "b.jsonl", [Event(f"name{n}", "entry", T0 + n) for n in range(100)])

    with site(tmp_path, "a", cameras_max=1) as daemon:
        assert ingest(daemon, tmp_path, right) == 0
        assert ingest(daemon, tmp_path, wrong) == 1
        said = capsys.readouterr().err
        assert "limits.cameras_max (1) is reached" in said
        assert re.search(r"; [0-9]+ events of [0-9]+ cameras? are dropped", said)
        assert said.count("\n") < 5
        with contextlib.closing(open_ingest_spool(tmp_path / "here", "a", Limits())) as spool:
            spool.append([Event("invented", "entry", T0)])
            assert ingest(daemon, tmp_path, right, "--anew") == 0
            assert (spool.queue().waiting("lobby"), spool.queue().waiting("invented")) == (0, 1)
        assert ingest(daemon, tmp_path, right, "--anew") == 0
        with contextlib.closing(open_ingest_spool(tmp_path / "here", "a", Limits())) as spool:
            assert (spool.queue().waiting("lobby"), spool.queue().waiting("invented")) == (0, 1)
    assert stored(tmp_path, "a") == 30


def test_who_waits_for_a_daemon_that_takes_nothing_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    first = lines(tmp_path / "a.jsonl", [Event("lobby", "entry", T0 + 90_000.0)])
    second = lines(tmp_path / "b.jsonl", [Event("lobby", "entry", T0)])
    with site(tmp_path, "a") as daemon:
        assert ingest(daemon, tmp_path, first) == 0

    class ToldWhy(SiteDelivery):
        """A delivery that has found the daemon, and been told a reason, however slow they are."""

        def start(self, cameras: Sequence[str] = ()) -> None:
            super().start(cameras)
            wait_for(lambda: self.sees_daemon, "the daemon to be visible")

        def own_reason(self) -> str:
            wait_for(lambda: bool(super(ToldWhy, self).own_reason()), "the daemon's reason")
            return super().own_reason()

    monkeypatch.setattr(publisher, "SiteDelivery", ToldWhy)
    monkeypatch.setattr(ingest_command, "PATIENCE_SECONDS", 0.4)
    with site(tmp_path, "a", now=T0) as daemon:
        says = ingest_command.log.warning

        def warning(text: str, *values: object) -> None:
            says(text, *values)
            threading.Thread(target=daemon.stop).start()

        monkeypatch.setattr(ingest_command.log, "warning", warning)
        assert ingest(daemon, tmp_path, second) == 69
    said = capsys.readouterr().err
    assert "still waiting, 1 events are not stored: this machine's clock is" in said
    assert "1 events are not stored: is `camtopod run` running" in said


def test_no_line_that_fits_is_an_input_that_cannot_be_read(tmp_path: Path) -> None:
    rubbish = tmp_path / "rubbish"
    rubbish.write_bytes(b"nothing\n" * 3)
    with site(tmp_path, "a") as daemon:
        assert ingest(daemon, tmp_path, rubbish) == 66


def test_an_older_daemon_is_said_to_be_older(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("camtopod.serve.outbox.delivery.RETRY_SECONDS", 0.1)
    file = tmp_path / "events"
    file.write_bytes(codec.to_json(Event("a", "entry", T0)))
    with open_daemon_session(small_config(tmp_path)) as bus:  # nobody answers on store/*
        bus.announce("daemon", "old")
        where = ["--connect", bus.endpoint, "--state", str(tmp_path / "here")]
        assert main(["ingest", "jsonl", str(file), *where]) == exits.BUS

    said = capsys.readouterr().err
    assert "does not answer: it is older than this program, upgrade it" in said
    assert "certificate" not in said


def test_another_site_that_is_away_delays_the_input_once_and_gets_the_events_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(ingest_command, "PATIENCE_SECONDS", 0.4)
    monkeypatch.setattr(ingest_command, "WAITING_EVENTS_MAX", 50)
    monkeypatch.setattr(ingest_command, "TRANSACTION_EVENTS_MAX", 40)
    ends = {"north": free_endpoint(), "south": free_endpoint()}
    config = tmp_path / "c.toml"
    config.write_text(
        f'[site]\nname = "north"\n[bus]\nconnect = ["{ends["north"]}"]\nconnect_seconds = 0.2\n'
        f'[sites.south]\nconnect = ["{ends["south"]}"]\n'
        f'[cameras.gate]\nsites = ["north", "south"]\n[state]\ndirectory = "{tmp_path / "here"}"\n'
    )
    cameras = ("gate", "yard")
    events = [Event(cameras[n % 2], "entry", T0 + n) for n in range(400)]
    file = lines(tmp_path / "events.jsonl", events)
    ingest = ["--config", str(config), "ingest", "jsonl", str(file)]

    with running(tmp_path / "north", ends["north"], site="north") as north:
        assert main(ingest) == exits.BUS
        said = capsys.readouterr().err
        assert said.count("the input does not wait for site south: ") == 1
        assert "is `camtopod run` running for site south?" in said.splitlines()[-1]
        assert north.status().events.stored == len(events)

        with running(tmp_path / "south", ends["south"], site="south") as south:
            monkeypatch.setattr(ingest_command, "PATIENCE_SECONDS", 60.0)
            assert main(ingest) == exits.DONE
            assert "0 events stored" in capsys.readouterr().err, "none of them is new"
            wait_for(lambda: south.status().events.stored == 200, "those of the gate")
        assert north.status().events.stored == len(events)
