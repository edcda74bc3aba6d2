"""`camtopod ingest` beside real daemons: which daemon takes an event, and the reported outcome."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from serving import T0, closing_event, numbered, small_config, wait_for, walkers

from camtopod import codec
from camtopod.cli.commands.ingest import UNACKNOWLEDGED_MAX
from camtopod.cli.main import main
from camtopod.config.settings import Config, SiteSettings
from camtopod.records import Event
from camtopod.serve.bus import session as buses
from camtopod.serve.daemon import Daemon


@contextlib.contextmanager
def site(folder: Path, name: str) -> Iterator[Daemon]:
    """Run a daemon of a site, with a state directory of its own."""
    config = msgspec.structs.replace(small_config(folder / name), site=SiteSettings(name))
    with Daemon(config, clock=lambda: T0 + 100_000.0) as daemon:
        yield daemon


def ingest(daemon: Daemon, folder: Path, file: Path, *more: str) -> int:
    where = ["--connect", daemon.endpoint, "--site", daemon.bus.site]
    return main([*where, "ingest", "jsonl", str(file), "--state", str(folder / "here"), *more])


def lines(path: Path, events: list[Event]) -> Path:
    path.write_bytes(b"".join(codec.to_json(event) + b"\n" for event in events))
    return path


def stored(folder: Path, name: str) -> list[bytes]:
    """Return the events in the journal of a daemon."""
    with contextlib.closing(sqlite3.connect(folder / name / "journal.db")) as journal:
        return [
            raw
            for (raw,) in journal.execute("SELECT raw FROM entry WHERE kind = 'event' ORDER BY id")
        ]


def test_each_of_two_sites_has_its_own_events_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = lines(tmp_path / "a.jsonl", [Event("lobby", "entry", T0 + n) for n in range(60)])
    second = lines(tmp_path / "b.jsonl", [Event("lobby", "entry", T0 + 0.5)])
    with site(tmp_path, "a") as a, site(tmp_path, "b") as b:
        assert ingest(a, tmp_path, first) == 0
        assert ingest(b, tmp_path, second) == 0
        assert ingest(a, tmp_path, second) == 0
        assert (a.status().events["stored"], b.status().events["stored"]) == (61, 1)
    assert len(stored(tmp_path, "a")) == 61
    said = capsys.readouterr().err
    assert "60 events published" in said
    assert "shorter than it was" not in said
    assert "closed database" not in said


def test_each_of_two_daemons_of_one_site_name_has_its_own_events_only(tmp_path: Path) -> None:
    first = lines(tmp_path / "a.jsonl", [Event("lobby", "entry", T0 + n) for n in range(60)])
    second = lines(tmp_path / "b.jsonl", [Event("lobby", "entry", T0 + 0.5)])
    with site(tmp_path / "one", "a") as one, site(tmp_path / "other", "a") as other:
        assert ingest(one, tmp_path, first) == 0
        assert ingest(other, tmp_path, second) == 0
        assert other.status().events["refilled"] == 0
        assert (one.status().events["stored"], other.status().events["stored"]) == (60, 1)


def test_what_became_of_the_events_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = lines(tmp_path / "walks.jsonl", [*walkers(30), closing_event()])
    events = len(recording.read_bytes().splitlines())
    old = lines(
        tmp_path / "old.jsonl", [Event("lobby", "entry", T0 - 50_000.0 - n) for n in range(20)]
    )
    both = lines(
        tmp_path / "both.jsonl",
        [Event("lobby", "entry", T0 + 12_000.0), Event("lobby", "exit", T0 - 9e4)],
    )
    early = lines(tmp_path / "early.jsonl", [Event("hall", "entry", T0 + 300_000.0)])

    with site(tmp_path, "a") as daemon:
        assert ingest(daemon, tmp_path, recording) == 0
        assert f"{events} accepted" in capsys.readouterr().err
        assert ingest(daemon, tmp_path, recording) == 0
        assert f"0 accepted, {events} duplicates" in capsys.readouterr().err
        assert ingest(daemon, tmp_path, old) == 1
        assert "0 accepted, 20 late" in capsys.readouterr().err
        assert ingest(daemon, tmp_path, both) == 0
        assert "1 accepted, 1 late" in capsys.readouterr().err
        assert ingest(daemon, tmp_path, early) == 1
        assert "0 accepted, 1 refused" in capsys.readouterr().err
        assert ingest(daemon, tmp_path, recording, "--anew") == 0
        assert f"1 accepted, {events - 1} late" in capsys.readouterr().err
        assert daemon.status().events["stored"] == 2 * events + 22


def test_what_came_before_a_restart_is_late_after_it(tmp_path: Path) -> None:
    with site(tmp_path, "a") as daemon:
        assert (
            ingest(
                daemon, tmp_path, lines(tmp_path / "walks.jsonl", [*walkers(30), closing_event()])
            )
            == 0
        )
    old = lines(tmp_path / "old.jsonl", [Event("lobby", "entry", T0 - 50_000.0)])
    with site(tmp_path, "a") as daemon:
        assert ingest(daemon, tmp_path, old) == 1


def test_no_line_that_fits_is_an_input_that_cannot_be_read(tmp_path: Path) -> None:
    rubbish = tmp_path / "rubbish"
    rubbish.write_bytes(b"nothing\n" * 3)
    with site(tmp_path, "a") as daemon:
        assert ingest(daemon, tmp_path, rubbish) == 66


def test_a_daemon_that_does_not_count_is_believed_to_have_stored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    events = lines(tmp_path / "walks.jsonl", walkers(3))
    bus = buses.open_daemon_session(small_config(tmp_path))

    def acknowledge(key: str, raw: bytes) -> None:
        event = codec.event_from_bytes(raw)
        bus.publish(
            f"ack/{event.camera}",
            {"camera": event.camera, "boot": event.boot, "seq": event.seq},
            "ack",
        )

    bus.subscribe("event/*", acknowledge)
    where = [
        "--connect",
        bus.endpoint,
        "ingest",
        "jsonl",
        str(events),
        "--state",
        str(tmp_path / "here"),
    ]
    assert main(where) == 0
    assert "0 not acknowledged" in capsys.readouterr().err
    bus.close()


def test_two_events_under_one_number_are_never_silently_one(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    first, second = numbered([Event("lobby", "entry", T0), Event("lobby", "exit", T0 + 1)])
    other = msgspec.structs.replace(first, t=T0 + 2)
    with site(tmp_path, "a") as daemon:
        publisher = buses.dial(
            msgspec.structs.replace(small_config(tmp_path, daemon.endpoint), site=SiteSettings("a"))
        )
        for event in (first, second, first, second):
            publisher.publish("event/lobby", event, "event")
        publisher.publish_raw("event/lobby", codec.to_json(first), "event")
        wait_for(lambda: daemon.status().events["duplicate"] == 3, "the duplicates")
        assert (daemon.status().events["contradicted"], daemon.status().reason) == (0, "")
        publisher.publish("event/lobby", other, "event")
        wait_for(
            lambda: daemon.status().events["contradicted"] == 1, "the contradiction to be found"
        )
        assert "two different events under one number (boot b1, seq 1)" in daemon.status().reason
        publisher.close()
    assert caplog.text.count("two different events under one number") == 1


def test_a_daemon_has_room_for_all_that_is_not_acknowledged() -> None:
    """Otherwise a daemon on a busy machine gets some from the spool, too late to learn them."""
    limits = Config().limits
    most = UNACKNOWLEDGED_MAX + limits.spool_batch_events
    assert most <= min(limits.inbox_camera_events_max, limits.inbox_events_max)
