"""The spool: commits stay, once and in order, and damage is noticed."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from serving import Failing

from camtopod import codec
from camtopod.records import Event
from camtopod.serve.outbox import spool_schema
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage import sqlite_file
from camtopod.serve.storage.sqlite_file import StateError


def event(number: int, camera: str = "lobby") -> Event:
    return Event(camera, "entry", float(number))


@pytest.fixture
def spool(tmp_path: Path) -> Iterator[Spool]:
    one = Spool(tmp_path / "spool.db", "boot-1", events_max=1000)
    yield one
    one.close()


# --- spool ----------------------------------------------------------------------------------------


def test_the_spool_counts_each_camera_without_gaps(spool: Spool) -> None:
    out = spool.append([event(1), event(2, "hall"), event(3)])
    assert [(one.camera, one.boot, one.seq) for one in out] == [
        ("lobby", "boot-1", 1),
        ("hall", "boot-1", 1),
        ("lobby", "boot-1", 2),
    ]
    batch = spool.batch("lobby", "boot-1", 0, 10)
    assert [codec.event_from_msgpack(raw) for _, raw in batch.events] == [out[0], out[2]]
    assert (batch.boot, batch.first, batch.more, batch.dropped) == ("boot-1", 1, False, 0)


def test_what_is_acknowledged_is_gone_and_the_next_opening_counts_anew(
    spool: Spool, tmp_path: Path
) -> None:
    spool.append([event(n) for n in range(5)])
    spool.ack("lobby", "boot-1", 3)
    assert len(spool) == 2
    assert [seq for seq, _ in spool.batch("lobby", "boot-1", 4, 10).events] == [4, 5]
    spool.ack("lobby", "other boot", 99)
    spool.ack("lobby", "boot-1", 2)
    assert len(spool) == 2
    spool.ack("lobby", "boot-1", 5)
    spool.close()
    again = Spool(tmp_path / "spool.db", "boot-2", events_max=1000)
    assert len(again) == 0
    assert [(one.boot, one.seq) for one in again.append([event(6)])] == [("boot-2", 1)]
    assert [seq for seq, _ in again.batch("lobby", "boot-1", 6, 10).events] == [1], (
        "of the boot that waits"
    )
    again.close()


def test_a_file_that_comes_back_as_it_was_gives_no_number_twice(
    spool: Spool, tmp_path: Path
) -> None:
    given = spool.append([event(n) for n in range(5)])
    spool.close()
    shutil.copytree(tmp_path, tmp_path.parent / f"{tmp_path.name}-image")
    for day in range(3):
        image = tmp_path.parent / f"{tmp_path.name}-day-{day}"
        shutil.copytree(tmp_path.parent / f"{tmp_path.name}-image", image)
        restored = Spool(image / "spool.db", f"day-{day}", events_max=1000)
        given += restored.append([event(100 * day + n) for n in range(5)])
        restored.close()
    assert len({(one.camera, one.boot, one.seq) for one in given}) == len(given) == 20


def test_more_acknowledged_than_given_is_not_taken_and_another_boot_begins(
    spool: Spool, tmp_path: Path
) -> None:
    spool.append([event(1), event(2)])
    assert not spool.ack("lobby", "boot-1", 10**9)
    assert len(spool) == 2
    assert [(one.boot, one.seq) for one in spool.append([event(3)])] == [("boot-1.1", 1)]
    spool.append([Event("lobby", "entry", 1.0, boot="theirs", seq=77)])
    assert spool.ack("lobby", "theirs", 10**9)
    spool.append([Event("lobby", "entry", 1.0, boot="theirs", seq=78)])
    assert len(spool) == 4, "of another boot as far as it is here"
    spool.close()
    again = Spool(tmp_path / "spool.db", "boot-2", events_max=1000)
    assert len(again) == 4
    again.close()


@pytest.mark.parametrize(
    ("daemon", "endpoint", "kept"),
    [
        *(
            ("anna", "tcp/here", 3),
            ("anna", "tcp/there", 3),
            ("berta", "tcp/here", 3),
            ("berta", "tcp/there", 0),
        ),
        *(("", "tcp/here", 3), ("", "tcp/there", 0)),
    ],
)
def test_what_one_daemon_has_acknowledged_is_given_to_no_other(
    daemon: str, endpoint: str, kept: int, spool: Spool, tmp_path: Path
) -> None:
    spool.note_daemon("anna", "tcp/here")
    spool.append([event(n) for n in range(5)])
    spool.ack("lobby", "boot-1", 3)
    spool.close()
    again = Spool(tmp_path / "spool.db", "boot-2", events_max=1000)
    again.note_daemon(daemon, endpoint)
    given = again.batch("lobby", None, 0, 10).events
    assert [seq for seq, _ in given] == [*range(4 - kept, 4), 4, 5]
    assert again.statistics()["kept"] == kept
    assert len(again) == 2
    again.close()


def test_an_empty_spool_says_where_it_will_begin(spool: Spool) -> None:
    assert spool.batch("lobby", None, 0, 10).first == 1
    spool.append([event(1), event(2)])
    spool.ack("lobby", "boot-1", 2)
    batch = spool.batch("lobby", "boot-1", 3, 10)
    assert (batch.first, batch.events, batch.acked) == (3, [], 2)


def test_batches_are_bounded_and_go_on(spool: Spool) -> None:
    spool.append([event(n) for n in range(25)])
    seqs: list[int] = []
    start, more = 0, True
    while more:
        batch = spool.batch("lobby", "boot-1", start, 10)
        assert len(batch.events) <= 10
        seqs += [seq for seq, _ in batch.events]
        start, more = seqs[-1] + 1, batch.more
    assert seqs == list(range(1, 26))


def test_an_event_with_its_own_boot_and_seq_keeps_them_and_is_spooled_once(spool: Spool) -> None:
    own = Event("lobby", "entry", 1.0, boot="theirs", seq=77)
    assert spool.append([own, own]) == [own, own]
    assert len(spool) == 1
    spool.append([event(2)])
    assert [seq for seq, _ in spool.batch("lobby", "theirs", 0, 10).events] == [77]
    assert [seq for seq, _ in spool.batch("lobby", "theirs", 0, 10).events] == [1], "by turns"
    assert [seq for seq, _ in spool.batch("lobby", "theirs", 0, 10).events] == [77]
    assert spool.batch("lobby", "unknown", 5, 10).boot == "theirs", "the oldest that waits"
    spool.ack("lobby", "theirs", 77)
    assert len(spool) == 1


def test_a_full_spool_drops_the_oldest_and_says_so(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    spool = Spool(tmp_path / "small.db", "b", events_max=10)
    spool.append([event(n) for n in range(8)])
    spool.append([event(n) for n in range(8)])
    assert len(spool) == 10
    batch = spool.batch("lobby", "b", 0, 100)
    assert [seq for seq, _ in batch.events] == list(range(7, 17))
    assert (batch.first, batch.dropped, spool.dropped) == (7, 6, 6)
    spool.append([event(n) for n in range(8)])
    assert [one.getMessage() for one in caplog.records] == [
        f"the spool {tmp_path}/small.db is full: its oldest events are dropped, 6 so far"
    ]
    spool.close()


def test_a_spool_has_one_process(spool: Spool, tmp_path: Path) -> None:
    with pytest.raises(StateError, match="held by another"):
        Spool(tmp_path / "spool.db", "b", events_max=10)


@pytest.mark.parametrize("durable", [False, True])
def test_an_append_that_raises_may_be_repeated(spool: Spool, durable: bool) -> None:
    spool.append([event(1)])
    spool._db = Failing(spool._db, durable)  # type: ignore[assignment]
    with pytest.raises(sqlite3.OperationalError):
        spool.append([event(2), event(3)])
    assert [one.seq for one in spool.append([event(2), event(3)])] == [2, 3]
    assert [seq for seq, _ in spool.batch("lobby", None, 0, 10).events] == [1, 2, 3]
    spool.ack("lobby", "boot-1", 3)
    assert len(spool) == 0


def test_a_full_spool_by_bytes_drops_the_oldest_and_its_file_stays_small(tmp_path: Path) -> None:
    bytes_max = 400_000
    spool = Spool(tmp_path / "small.db", "b", events_max=10**6, bytes_max=bytes_max)
    for start in range(0, 20_000, 500):
        spool.append([event(n) for n in range(start, start + 500)])
    assert (tmp_path / "small.db").stat().st_size < bytes_max + 200_000
    assert spool.dropped > 10_000
    assert len(spool) + spool.dropped == 20_000
    assert len(spool) > 1000
    batch = spool.batch("lobby", "b", 0, 10**6)
    assert [seq for seq, _ in batch.events] == list(range(spool.dropped + 1, 20_001))
    spool.close()


def test_what_was_dropped_is_still_known_after_a_restart(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "small.db", "b", events_max=10)
    spool.append([event(n) for n in range(17)])
    spool.close()
    again = Spool(tmp_path / "small.db", "c", events_max=10)
    assert (again.dropped, again.batch("lobby", "b", 0, 10).dropped) == (7, 7)
    again.append([event(1)])
    assert again.statistics() == {
        "unacknowledged": 10,
        "kept": 0,
        "dropped": 8,
        "damaged_events": 0,
        "damaged_files": 0,
    }
    again.close()


def test_acknowledged_events_are_kept_for_a_journal_that_came_back_shorter(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "spool.db", "b", events_max=1000, kept_events_max=80)
    for start in range(0, 300, 10):
        spool.append([event(n) for n in range(start, start + 10)])
        spool.ack("lobby", "b", start + 10)
    assert len(spool) == 0
    batch = spool.batch("lobby", "b", 280, 1000)
    assert [seq for seq, _ in batch.events] == list(range(280, 301))
    assert batch.acked == 300
    longest = spool.batch("lobby", "b", 0, 1000)
    assert 80 <= len(longest.events) <= 100
    assert longest.first == longest.events[0][0] == 301 - len(longest.events)
    at_ease = spool.batch("lobby", "b", 301, 1000)
    assert (at_ease.first, at_ease.events, at_ease.more) == (301, [], False)
    spool.close()


def test_what_is_acknowledged_of_older_boots_is_not_forgotten_by_a_kill(tmp_path: Path) -> None:
    """The daemon knows only a camera's newest boots; events of others would count twice."""
    path = tmp_path / "spool.db"
    boots = [f"boot-{number:02}" for number in range(20)]
    for number, boot in enumerate(boots):
        with contextlib.closing(Spool(path, boot, events_max=1000)) as killed:
            killed.append([event(n) for n in range(3)])
            path = copy_of(path, tmp_path / f"after {number} kills")
    with contextlib.closing(Spool(path, "newest", events_max=1000)) as spool:
        spool.append([event(1)])
        for boot in boots:
            spool.ack("lobby", boot, 3)
        assert len(spool) == 1
        path = copy_of(path, tmp_path / "at the end")
    with contextlib.closing(Spool(path, "another", events_max=1000)) as again:
        assert len(again) == 1, "only that of the newest boot comes again"


def test_a_full_spool_forgets_what_is_acknowledged_before_it_drops_anything(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "spool.db", "b", events_max=20, kept_events_max=100)
    spool.append([event(n, "hall") for n in range(5)])
    spool.append([event(n) for n in range(15)])
    spool.ack("lobby", "b", 10)
    spool.append([event(n) for n in range(8)])
    assert (spool.dropped, len(spool), spool.statistics()["kept"]) == (0, 18, 2)
    spool.append([event(n) for n in range(4)])
    assert (spool.dropped, len(spool), spool.statistics()["kept"]) == (2, 20, 0)
    assert [seq for seq, _ in spool.batch("hall", "b", 0, 10).events] == [3, 4, 5]
    spool.close()


def copy_of(path: Path, to: Path) -> Path:
    """Copy the files as a kill would leave them."""
    to.mkdir()
    for name in (path.name, f"{path.name}-wal"):
        shutil.copyfile(path.with_name(name), to / name)
    return to / path.name


@pytest.mark.parametrize("read", ["acked", "meta"])
def test_a_spool_that_cannot_be_read_is_closed_again(
    read: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "spool.db"
    with contextlib.closing(Spool(path, "boot-1", events_max=10)) as one:
        one.append([event(1)])

    def fails(*_: object) -> None:
        raise sqlite3.OperationalError("disk I/O error")

    with monkeypatch.context() as patch:
        patch.setattr(spool_schema, read, fails)
        with pytest.raises(StateError, match="disk I/O error"):
            Spool(path, "boot-2", events_max=10)
    Spool(path, "boot-3", events_max=10).close()  # nothing holds its lock


def test_a_spool_that_was_killed_begins_a_new_boot_with_what_was_in_it(
    spool: Spool, tmp_path: Path
) -> None:
    spool.append([event(1), event(2)])
    again = Spool(copy_of(tmp_path / "spool.db", tmp_path / "killed"), "boot-2", events_max=1000)
    assert again.boot == "boot-2", "what the disk lost of its count nobody knows"
    stored = again.append([event(3)])[0]
    assert (stored.boot, stored.seq) == ("boot-2", 1)
    assert [seq for seq, _ in again.batch("lobby", None, 0, 10).events] == [1, 2]
    assert len(again) == 3
    again.close()


def test_other_events_after_an_append_that_raised_get_numbers_of_their_own(spool: Spool) -> None:
    spool._db = Failing(spool._db, durable=True)  # type: ignore[assignment]
    with pytest.raises(sqlite3.OperationalError):
        spool.append([event(1), event(2, "hall")])
    assert [one.seq for one in spool.append([event(3), event(4)])] == [2, 3]
    assert [one.seq for one in spool.append([event(5, "hall")])] == [2]
    assert [
        codec.event_from_msgpack(raw).t for _, raw in spool.batch("lobby", None, 0, 10).events
    ] == [1, 3, 4]
    assert len(spool) == 5


def test_state_is_nobody_elses_to_read(tmp_path: Path) -> None:
    path = tmp_path / "new" / "state" / "spool.db"
    spool = Spool(path, "b", events_max=10)
    spool.append([event(1)])
    assert path.parent.stat().st_mode & 0o777 == 0o700
    modes = {one.name: one.stat().st_mode & 0o777 for one in path.parent.iterdir()}
    assert modes == dict.fromkeys(("spool.db", "spool.db-shm", "spool.db-wal", "spool.lock"), 0o600)
    spool.close()
    path.chmod(0o644)
    Spool(path, "b", events_max=10).close()
    assert path.stat().st_mode & 0o777 == 0o600


def test_a_damaged_spool_is_set_aside_and_what_can_be_read_goes_on(
    tmp_path: Path, caplog: Any
) -> None:
    path = tmp_path / "spool.db"
    spool = Spool(path, "boot-1", events_max=10_000)
    for start in range(0, 1500, 100):
        spool.append([event(n) for n in range(start, start + 100)])
    spool.close()
    content = bytearray(path.read_bytes())
    middle = len(content) // 2 // 4096 * 4096
    content[middle : middle + 4096] = bytes(4096)
    path.write_bytes(content)
    again = Spool(path, "boot-2", events_max=10_000)
    assert (tmp_path / "spool.db.damaged-1").read_bytes() == content
    assert 1300 < again.rescued < 1500
    assert again.boot == "boot-2"
    assert len(again.batch("lobby", "boot-1", 0, 10_000).events) == again.rescued
    assert "is damaged" in caplog.text
    assert again.statistics()["damaged_files"] == 1
    assert again.append([event(1)])[0].seq == 1
    again.close()
    once_more = Spool(path, "boot-3", events_max=10_000)
    assert (once_more.rescued, len(once_more)) == (0, again.rescued + 1)
    once_more.close()


def test_a_damaged_event_is_not_given_and_its_neighbours_are(spool: Spool) -> None:
    spool.append([event(n) for n in range(5)])
    spool._db.execute("UPDATE event SET seq = 7 WHERE seq = 2")
    assert [seq for seq, _ in spool.batch("lobby", "boot-1", 0, 10).events] == [1, 3, 4, 5]
    assert [seq for seq, _ in spool.batch("lobby", "boot-1", 0, 10).events] == [1, 3, 4, 5]
    assert spool.statistics()["damaged_events"] == 1


def test_a_disk_that_damages_every_file_is_not_filled_up(tmp_path: Path) -> None:
    path = tmp_path / "spool.db"
    for _ in range(sqlite_file.DAMAGED_FILES_MAX):
        path.write_bytes(b"rubbish " * 1000)
        Spool(path, "b", events_max=10).close()
    path.write_bytes(b"rubbish " * 1000)
    with pytest.raises(StateError, match="check the disk"):
        Spool(path, "b", events_max=10)
    assert path.read_bytes() == b"rubbish " * 1000
    assert [one.name for one in sqlite_file.damaged_files(path)] == [
        f"spool.db.damaged-{n}" for n in range(1, 9)
    ]


def test_a_read_only_file_is_not_taken_for_a_damaged_one(tmp_path: Path) -> None:
    error = sqlite3.OperationalError("attempt to write a readonly database")
    error.sqlite_errorcode = sqlite3.SQLITE_READONLY
    (tmp_path / "one.db").write_bytes(b"")
    assert sqlite_file.is_damage(error, tmp_path / "one.db")
    assert not sqlite_file.is_damage(error, tmp_path / "missing" / "one.db")
    error.sqlite_errorcode = sqlite3.SQLITE_FULL
    assert not sqlite_file.is_damage(error, tmp_path / "one.db")


def test_text_that_is_no_text_any_more_damages_its_row_alone(spool: Spool) -> None:
    spool.append([event(1, "hall"), event(2), event(3)])
    spool._db.execute(
        "UPDATE event SET boot = CAST(x'62c3286f' AS TEXT) WHERE seq = 1 AND camera = 'lobby'"
    )
    assert [seq for seq, _ in spool.batch("lobby", "boot-1", 0, 10).events] == [2]
