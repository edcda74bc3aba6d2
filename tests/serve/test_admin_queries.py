"""Operators' commands to a daemon on a real bus: forget, rename, reset."""

from __future__ import annotations

import contextlib
import logging
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from serving import (
    SPAN_SECONDS,
    T0,
    WAIT_SECONDS,
    all_out,
    closing_event,
    numbered,
    wait_for,
    walkers,
)
from test_daemon import NOW, Site, caught_up, journal_of, put

from camtopod import codec
from camtopod.admin import Command, Forget, Rename, Reset, TakeBack
from camtopod.records import CameraFigures, Event, Recent, Topology
from camtopod.serve.admin_queries import Done, command_of, parameters_of
from camtopod.serve.bus import Bus, QueryError, TopologySubscriber
from camtopod.serve.daemon import Daemon
from camtopod.serve.ingest import Names, read_names
from camtopod.serve.storage import Journal


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    one = Site(tmp_path)
    yield one
    one.close()


def ask(bus: Bus, command: Command) -> str:
    key, parameters = parameters_of(command)
    [(_, answer)] = bus.query(key, parameters, seconds=WAIT_SECONDS, one=True)
    return codec.read(Done, answer, pack=True).done


def learned(daemon: Daemon, bus: Bus) -> None:
    """Teach the daemon three cameras."""
    events = [*numbered(walkers(60)), closing_event()]
    put(bus, *events)
    wait_for(lambda: all_out(daemon, len(events)), "all to be learned")
    assert set("abc") <= cameras(daemon)


def seen(daemon: Daemon, bus: Bus) -> None:
    """Let three cameras send an event each."""
    put(bus, *numbered([fresh(camera, 0) for camera in "abc"]))
    wait_for(lambda: daemon.status().events.stored == 3, "the events")


def cameras(daemon: Daemon) -> set[str]:
    topology = daemon.topology
    return set() if topology is None else {camera.id for camera in topology.cameras}


def recent_cameras(bus: Bus) -> set[str]:
    [(_, answer)] = bus.query("recent", seconds=WAIT_SECONDS, one=True)
    return {event.camera for event in codec.read(Recent, answer, pack=True).events}


def followed(view: TopologySubscriber, daemon: Daemon) -> bool:
    view.update()
    held = view.topology
    newest = daemon.topology
    return held is not None and newest is not None and held.digest == newest.digest


def raw_of(daemon: Daemon, camera: str) -> set[bytes]:
    """Return what the journal has of a camera's events."""
    entries = (entry for _, entry in daemon._journal.entries())
    return {entry.raw for entry in entries if entry is not None and entry.camera == camera}


def fresh(camera: str, number: int, kind: str = "entry") -> Event:
    """Return an event after all that `learned` has sent."""
    return Event(camera, kind, NOW - 100.0 + number, 0.5, 0.5, str(number))  # type: ignore[arg-type]


def refusal(bus: Bus, key: str, parameters: dict[str, object]) -> str:
    """Return in which words a query is refused; "" if the answer does not come in time."""
    try:
        assert bus.query(key, parameters, seconds=WAIT_SECONDS) == []
    except QueryError as error:
        return str(error)
    return ""


# --- forget ---------------------------------------------------------------------------------------


def test_a_forgotten_camera_leaves_at_once_and_its_spool_empties(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    daemon = site.daemon()
    bus = site.client(daemon)
    learned(daemon, bus)
    view = TopologySubscriber(bus)
    caught_up(view, 1)
    assert daemon.topology is not None
    version = str(daemon.topology.version)
    said = ask(bus, Forget("b"))
    assert said.startswith("b is forgotten")
    wait_for(lambda: "b" not in cameras(daemon), "the next version")
    wait_for(lambda: followed(view, daemon), "it to be followed")
    assert "b" not in daemon.status().cameras
    wait_for(lambda: "is not kept" in refusal(bus, "topology", {"version": version}), "a refusal")
    wait_for(lambda: raw_of(daemon, "b") == {b""}, "its events to leave the journal")
    assert b"" not in raw_of(daemon, "a")

    # Its events are refused, and leave the spool; those of others are learned.
    publisher = site.publisher()
    publisher.attach(site.client(daemon))
    with caplog.at_level(logging.WARNING):
        publisher.publish(*(fresh("b", n) for n in range(20)), *(fresh("a", n) for n in range(5)))
        assert publisher.wait_stored(10)
    assert publisher.outcome() == (0, 20)
    assert caplog.text.count("events of b are refused, as this name is forgotten") == 1
    status = daemon.status()
    assert status.names.forgotten == {"b": 20}
    assert "b" not in status.cameras
    assert cameras(daemon) & {"a", "b"} == {"a"}

    # Taken back, it is a new camera.
    assert "accepted again" in ask(bus, TakeBack("b"))
    publisher.publish(*(fresh("b", 30 + n) for n in range(3)))
    wait_for(lambda: daemon.status().cameras.get("b", CameraFigures()).events == 3, "its events")
    assert daemon.status().names.forgotten == {}


def killed_after(site: Site, daemon: Daemon, *commands: Command) -> Daemon:
    """Kill the daemon when it has stored commands and learned none; start it again."""
    daemon.stop()
    with contextlib.closing(Journal(site.directory / "state")) as journal:
        for command in commands:
            names = Names(read_names(journal), lambda: NOW)
            _, item, _ = names.prepare(command, set("abc"), len(journal) + 1)
            journal.commit([item.entry], meta=item.meta)
    return site.daemon()


def test_killed_between_forget_and_the_next_version_it_starts_again(site: Site) -> None:
    daemon = site.daemon()
    learned(daemon, site.client(daemon))
    daemon = killed_after(site, daemon, Forget("b"))
    wait_for(lambda: "b" not in cameras(daemon), "the next version")


def test_erasing_goes_on_after_a_start(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    daemon = site.daemon()
    learned(daemon, site.client(daemon))
    with monkeypatch.context() as patch:
        patch.setattr(Journal, "forget", lambda *given: True)
        ask(site.client(daemon), Forget("b"))
        wait_for(lambda: "b" not in cameras(daemon), "the next version")
        daemon.stop()
    daemon = site.daemon()
    wait_for(lambda: raw_of(daemon, "b") == {b""}, "its events to leave the journal", 5.0)


def test_what_was_forgotten_is_gone_though_it_was_taken_back_at_once(site: Site) -> None:
    daemon = site.daemon()
    learned(daemon, site.client(daemon))
    assert daemon.topology is not None
    version = {"version": str(daemon.topology.version)}
    daemon = killed_after(site, daemon, Forget("b"), TakeBack("b"))
    wait_for(lambda: "b" not in cameras(daemon), "the next version")
    bus = site.client(daemon)
    assert "is not kept" in refusal(bus, "topology", version)
    wait_for(lambda: raw_of(daemon, "b") == {b""}, "its events to leave the journal")

    # What it sends then is learned, stays, and is in versions, also after a start.
    put(bus, Event("b", "entry", NOW - 5 * SPAN_SECONDS), fresh("c", 1), fresh("late", 1))
    wait_for(lambda: daemon.status().events.stored == 3, "the events")
    ask(bus, Forget("a"))
    wait_for(lambda: cameras(daemon) & {"a", "b"} == {"b"}, "the version with it")
    for _ in range(2):
        assert raw_of(daemon, "b") > {b""}
        [(_, answer)] = bus.query("topology", seconds=WAIT_SECONDS, one=True)
        newest = codec.read(Topology, answer, pack=True)
        assert "b" in {camera.id for camera in newest.cameras}
        assert "is not kept" in refusal(bus, "topology", version)
        daemon.stop()
        daemon = site.daemon()
        bus = site.client(daemon)


def test_events_of_a_forgotten_camera_are_not_kept_in_memory(site: Site) -> None:
    daemon = site.daemon()
    bus = site.client(daemon)
    seen(daemon, bus)
    assert recent_cameras(bus) == set("abc")

    ask(bus, Forget("b"))
    assert recent_cameras(bus) == set("ac")
    daemon.stop()
    daemon = site.daemon()
    bus = site.client(daemon)
    assert recent_cameras(bus) == set("ac"), "nor made again at a start"

    ask(bus, TakeBack("b"))
    daemon.stop()
    assert recent_cameras(site.client(site.daemon())) == set("ac"), "it begins anew"


def test_a_command_is_in_force_when_it_is_stored_and_not_before(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = site.daemon()
    bus = site.client(daemon)
    seen(daemon, bus)
    epoch = daemon.epoch

    def full(*given: object, **more: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(Journal, "commit", full)
        for command in (Forget("b"), Rename("b", "yard"), Reset()):
            with pytest.raises(
                QueryError, match="journal cannot be written: database or disk is f"
            ):
                ask(bus, command)
        put(bus, fresh("a", 1))  # waits to be stored
        wait_for(lambda: bool(daemon._intake.queue.waiting), "the event")
        wait_for(lambda: daemon.status().state == "degraded", "the disk to be found full")
        with pytest.raises(QueryError, match="disk is full; nothing has changed"):
            ask(bus, Forget("b"))
        status = daemon.status()
        assert (status.names.forgotten, status.names.renamed, status.names.reset) == ({}, {}, None)

    # There is room again: nothing is made up for.
    wait_for(lambda: daemon.status().state == "running", "the journal to be written")
    put(bus, fresh("b", 2))
    wait_for(lambda: daemon.status().events.stored == 5, "events to be stored")
    status = daemon.status()
    assert (status.cameras["b"].newest, status.names.forgotten) == (fresh("b", 2).t, {})
    assert "command" not in {row[0] for row in journal_of_stopped(site, daemon)}
    assert site.daemon().epoch == epoch


def test_what_is_forgotten_stays_so_when_the_note_of_it_is_damaged(site: Site) -> None:
    daemon = site.daemon()
    bus = site.client(daemon)
    seen(daemon, bus)
    ask(bus, Forget("b"))
    ask(bus, Rename("c", "yard"))
    put(bus, fresh("yard", 5))
    wait_for(lambda: "c" in daemon.status().names.forgotten, "the old name to end")
    daemon.stop()
    with contextlib.closing(sqlite3.connect(site.directory / "state" / "journal.db")) as database:
        database.execute("UPDATE meta SET value = replace(value, 'b', 'x') WHERE key = 'names'")
        database.commit()

    daemon = site.daemon()
    put(site.client(daemon), fresh("b", 9), fresh("c", 3), fresh("c", 8))
    wait_for(lambda: daemon.status().names.forgotten == {"b": 1, "c": 1}, "what is refused")
    assert daemon.status().cameras["yard"].events == 1


def journal_of_stopped(site: Site, daemon: Daemon) -> list[tuple[str, str, str | None, int | None]]:
    daemon.stop()
    return journal_of(site)


# --- rename ---------------------------------------------------------------------------------------


def test_a_renamed_camera_goes_on_whichever_name_its_grabber_uses(site: Site) -> None:
    daemon = site.daemon()
    bus = site.client(daemon)
    learned(daemon, bus)
    topology = daemon.topology
    assert topology is not None
    zones = {zone.id for zone in topology.zones if zone.camera == "b"}
    assert "b goes on as yard" in ask(bus, Rename("b", "yard"))
    wait_for(lambda: "yard" in cameras(daemon), "the next version")
    topology = daemon.topology
    assert topology is not None
    renamed = {zone.id.replace("yard/", "b/") for zone in topology.zones if zone.camera == "yard"}
    assert renamed == zones

    # Its grabber still has the old name, and an event comes twice.
    publisher = site.publisher()
    publisher.attach(site.client(daemon))
    publisher.publish(*(fresh("b", n) for n in range(10)))
    assert publisher.wait_stored(10), "stored under the number of the old name"
    before = daemon.status().cameras["yard"].events
    put(bus, msgspec.structs.replace(fresh("b", 9), boot="boot-spool", seq=10))
    wait_for(lambda: daemon.status().events.duplicate == 1, "the duplicate")
    status = daemon.status()
    assert (status.cameras["yard"].events, status.cameras["yard"].alive) == (before, True)
    assert "b" not in status.cameras
    assert status.names.renamed == {"b": "yard"}

    # It gets the new name: from then on the old one is refused.
    put(bus, *numbered([fresh("yard", 20), fresh("b", 21)], "new"))
    wait_for(lambda: daemon.status().names.forgotten == {"b": 1}, "the old name to end")
    status = daemon.status()
    assert status.names.renamed == {}
    assert status.cameras["yard"].events == before + 1
    kinds = [row[0] for row in journal_of_stopped(site, daemon)]
    assert kinds[-4:] == ["event", "command", "event", "refused"]


def test_what_the_old_name_has_of_before_counts_for_the_new_one(site: Site) -> None:
    daemon = site.daemon()
    bus = site.client(daemon)
    seen(daemon, bus)
    ask(bus, Rename("b", "yard"))
    put(bus, *numbered([fresh("yard", 20)], "new"))
    wait_for(lambda: "b" in daemon.status().names.forgotten, "the old name to end")
    before = daemon.status().cameras["yard"].events

    # Its spool delivers twenty events of before, and one that two cameras would have to send.
    publisher = site.publisher()
    publisher.attach(site.client(daemon))
    publisher.publish(*(fresh("b", n) for n in range(20)), fresh("b", 21))
    assert publisher.wait_stored(10)
    status = daemon.status()
    assert status.cameras["yard"].events == before + 20
    assert status.names.forgotten == {"b": 1}

    # Under a third name it is still the same camera; the name that is free begins a new one.
    ask(bus, Rename("yard", "court"))
    publisher.publish(fresh("b", 19), fresh("b", 22))
    assert publisher.wait_stored(10)
    assert daemon.status().cameras["court"].events == before + 21
    ask(bus, TakeBack("b"))
    publisher.publish(fresh("b", 18))
    assert publisher.wait_stored(10)
    assert daemon.status().cameras["b"].events == 1
    daemon.stop()
    with contextlib.closing(Journal(site.directory / "state")) as journal:
        refused = [one for _, one in journal.entries() if one is not None and one.kind == "refused"]
    assert [(one.camera, one.seq, one.raw) for one in refused] == [("b", 21, b""), ("b", 23, b"")]


def test_a_renamed_camera_can_get_its_name_back(site: Site) -> None:
    daemon = site.daemon()
    bus = site.client(daemon)
    learned(daemon, bus)
    ask(bus, Rename("b", "yrad"))
    ask(bus, Rename("yrad", "b"))
    wait_for(lambda: {"b"} == cameras(daemon) & {"b", "yrad"}, "the name")
    assert daemon.status().names.renamed == {"yrad": "b"}


@pytest.mark.parametrize(
    ("command", "why"),
    [
        (Forget("x"), "there is no camera x; there are: a, b, c"),
        (TakeBack("b"), "b is not forgotten; forgotten names: none"),
        (Rename("x", "y"), "there is no camera x"),
        (Rename("b", "b"), "b has this name already"),
        (Rename("b", "a"), "there is a camera a already"),
    ],
)
def test_a_command_that_makes_no_sense_is_refused_with_the_reason(
    command: Command, why: str, taught: tuple[Daemon, Bus]
) -> None:
    daemon, bus = taught
    entries = daemon.status().journal.entries
    with pytest.raises(QueryError, match=why):
        ask(bus, command)
    assert daemon.status().journal.entries == entries


@pytest.mark.parametrize(
    ("key", "parameters", "why"),
    [
        ("admin/format", {}, "admin/format: Invalid value 'format'"),
        ("admin/forget", {}, "camera"),
        ("admin/rename", {"old": "b"}, "new"),
        ("admin/rename", {"old": "b", "new": "a b"}, "new"),
        ("admin/rename", {"old": "b", "new": "daemon"}, "not `daemon` - at `.*new"),
        ("admin/forget", {"camera": "b", "take_back": "TRUE"}, "unknown parameter take_back"),
        ("admin/reset", {"t": "5"}, "unknown parameter t"),
    ],
)
def test_a_malformed_query_is_refused_with_the_reason(
    key: str, parameters: dict[str, str], why: str, taught: tuple[Daemon, Bus]
) -> None:
    with pytest.raises(QueryError, match=why):
        taught[1].query(key, parameters, one=True)


def test_every_command_can_be_asked_for() -> None:
    for command in (
        Forget("b"),
        TakeBack("b"),
        Rename("a", "b"),
        Reset(),
    ):
        assert command_of(*parameters_of(command)) == command


@pytest.fixture(scope="module")
def taught(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Daemon, Bus]]:
    one = Site(tmp_path_factory.mktemp("taught"))
    daemon = one.daemon()
    bus = one.client(daemon)
    learned(daemon, bus)
    yield daemon, bus
    one.close()


# --- reset ----------------------------------------------------------------------------------------


def test_a_reset_begins_anew_and_events_of_before_do_not_count(site: Site) -> None:
    daemon = site.daemon()
    bus = site.client(daemon)
    learned(daemon, bus)
    ask(bus, Forget("c"))
    before = daemon.epoch
    view = TopologySubscriber(bus)
    caught_up(view, 1)
    assert "the site begins anew" in ask(bus, Reset())
    wait_for(lambda: daemon.epoch > before, "a new epoch")
    wait_for(lambda: daemon.status().version == 1, "an empty version")
    assert (cameras(daemon), daemon.status().cameras) == (set(), {})
    wait_for(lambda: followed(view, daemon), "it to be followed")
    status = daemon.status()
    assert (status.names.forgotten, status.names.reset) == ({}, NOW)
    with pytest.raises(QueryError, match="there is no camera x"):
        ask(bus, Forget("x"))

    # What was in a spool or under way is stored and not learned.
    publisher = site.publisher()
    publisher.attach(site.client(daemon))
    publisher.publish(*(fresh("a", n) for n in range(5)))
    assert publisher.wait_stored(10)
    assert daemon.status().names.before_reset == 5
    assert daemon.status().cameras == {}

    # What comes after it is: the first version is due with the first events.
    site.now = NOW + 86_400.0
    later = [msgspec.structs.replace(event, t=event.t - T0 + NOW + 600.0) for event in walkers(20)]
    late = msgspec.structs.replace(closing_event(), t=NOW + 40_000.0)
    put(bus, *numbered(later, "later"), late)
    wait_for(lambda: set("abc") <= cameras(daemon), "a new beginning")
    assert daemon.status().epoch == daemon.epoch > before
    daemon.stop()
    again = site.daemon()
    assert (again.epoch, set("abc") <= cameras(again)) == (daemon.epoch, True)
