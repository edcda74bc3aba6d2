"""The journal: commits stay, once and in order; damage is noticed; old data is deleted."""

from __future__ import annotations

import errno
import os
import sqlite3
import zlib
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from serving import Failing

from camtopod.config.settings import KeepSettings
from camtopod.serve.storage import journal as journals, journal_schema
from camtopod.serve.storage.journal import (
    Entry,
    Journal,
    Snapshot,
    StoredVersion,
)
from camtopod.serve.storage.sqlite_file import Damaged, StateError

NOW = 1_700_000_000.0


def entry(number: int, boot: str = "b1") -> Entry:
    return Entry("event", "lobby", boot, number, f"raw {number}".encode())


def version(number: int, content: bytes = b"{}", epoch: str = "E") -> StoredVersion:
    return StoredVersion(epoch, number, f"d{number}", content)


def kept(journal: Journal) -> list[int]:
    return [number for number, _ in journal.entries()]


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with closing(Journal(tmp_path)) as one:
        yield one


def test_it_gives_back_what_was_committed_in_order(journal: Journal, tmp_path: Path) -> None:
    journal.commit([entry(1), entry(2)])
    journal.commit(
        [entry(3), Entry("advance", "", None, None, b"12.5")],
        [version(1)],
        Snapshot(3, "E", b"state"),
    )
    expected = [entry(1), entry(2), entry(3), Entry("advance", "", None, None, b"12.5")]
    assert [one for _, one in journal.entries()] == expected
    journal.close()
    with closing(Journal(tmp_path)) as again:
        assert [one for _, one in again.entries()] == expected
        assert [one for _, one in again.entries(after=1)] == expected[1:]
        assert again.numbers() == {("lobby", "b1"): 3}
        assert again.versions("E") == {1: "d1"}
        assert again.version("E", 1) == again.newest_version() == b"{}"
        assert again.version("E", 2) is None
        assert again.snapshots() == [Snapshot(3, "E", b"state")]
        assert len(again) == 4


def test_nothing_is_kept_of_a_forgotten_camera_once_a_state_without_it_is(
    journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journal_schema, "ERASED_ROWS_MAX", 3)
    yard = [Entry("event", "yard", None, None, b"raw"), Entry("future", "yard", "b", 1, b"raw")]
    command = Entry("command", "", None, None, b"forget yard")
    again = Entry("event", "yard", "b", 2, b"raw")
    journal.commit([yard[0], entry(1), yard[1]], snapshot=Snapshot(3, "E", b"with"))
    journal.commit([command, entry(2), again])
    assert not journal.forget({"yard": 4})
    assert [one for _, one in journal.entries()][:3] == [yard[0], entry(1), yard[1]]

    journal.commit([], snapshot=Snapshot(5, "E", b"without"))
    assert journal.forget({"yard": 4})
    assert not journal.forget({"yard": 4})
    numbers = [Entry("refused", "yard", one.boot, one.seq, b"") for one in yard]
    assert [one for _, one in journal.entries()] == [
        numbers[0],
        entry(1),
        numbers[1],
        command,
        entry(2),
        again,
    ]
    assert journal.snapshots() == [Snapshot(5, "E", b"without")]
    assert journal.numbers() == {("lobby", "b1"): 2, ("yard", "b"): 2}


def test_a_directory_has_one_daemon(journal: Journal, tmp_path: Path) -> None:
    with pytest.raises(StateError, match="held by another camtopod process"):
        Journal(tmp_path)
    journal.close()
    Journal(tmp_path).close()


def test_a_file_system_without_locks_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(fd: int, how: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", none)
    with pytest.raises(StateError, match=r"No locks available: the state needs a local disk"):
        Journal(tmp_path)


def test_a_directory_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StateError, match="cannot write the state directory"):
        Journal(tmp_path / "file" / "state")


def test_a_version_has_one_content(journal: Journal) -> None:
    journal.commit([], [version(1, b"one")])
    journal.commit([], [StoredVersion("E", 1, "other", b"two")])
    assert (journal.versions("E"), journal.version("E", 1)) == ({1: "d1"}, b"one")
    journal.commit([], [version(1, b"anew", epoch="F")])
    assert journal.newest_version() == b"anew"


def test_only_the_newest_snapshots_stay(journal: Journal) -> None:
    for position in (5, 9, 12):
        journal.commit([], snapshot=Snapshot(position, "E", b"s%d" % position))
    assert [one.position for one in journal.snapshots()] == [12, 9]


@pytest.mark.parametrize("column", ["raw", "kind", "camera", "boot", "seq", "stored"])
def test_a_damaged_entry_is_noticed_and_left_where_it_is(journal: Journal, column: str) -> None:
    journal.commit([entry(1), entry(2), entry(3)])
    journal._db.execute(f"UPDATE entry SET {column} = x'00' WHERE id = 2")
    assert [one for _, one in journal.entries()] == [entry(1), None, entry(3)]
    assert journal._db.execute("SELECT COUNT(*) FROM entry").fetchone() == (3,)


def test_other_damaged_rows_are_reported_and_not_used(
    journal: Journal, caplog: pytest.LogCaptureFixture
) -> None:
    journal.set_meta("epoch", "E")
    for position in (1, 2):
        journal.commit([entry(position)], [version(position)], Snapshot(position, "E", b"state"))
    journal._db.execute("UPDATE snapshot SET state = x'00' WHERE position = 2")
    journal._db.execute("UPDATE version SET content = x'00' WHERE version = 2")
    journal._db.execute("UPDATE stream SET seq = 7")
    journal._db.execute("UPDATE meta SET value = 'F' WHERE key = 'epoch'")
    assert [one.position for one in journal.snapshots()] == [1]
    assert journal.version("E", 2) is None
    assert journal.numbers() == {("lobby", "b1"): 2}, "that of the newest entry"
    assert journal.meta("epoch") is None
    assert len([record for record in caplog.records if "damaged" in record.message]) == 4


def test_a_file_that_is_no_database_is_set_aside(tmp_path: Path) -> None:
    (tmp_path / "journal.db").write_bytes(b"something else" * 100)
    with closing(Journal(tmp_path)) as anew:
        assert anew.set_aside is not None
        assert anew.set_aside.read_bytes() == b"something else" * 100
        anew.commit([entry(1)])


def test_what_can_be_read_of_a_damaged_journal_goes_on(journal: Journal, tmp_path: Path) -> None:
    journal.set_meta("epoch", "E")
    for number in range(1, 400):
        journal.commit(
            [entry(number)], [version(number)], Snapshot(number, "E", b"state %d" % number)
        )
    journal.close()
    with closing(sqlite3.connect(tmp_path / "journal.db")) as file:
        pages = dict(file.execute("SELECT name, rootpage FROM sqlite_schema"))
        size = file.execute("PRAGMA page_size").fetchone()[0]
    content = bytearray((tmp_path / "journal.db").read_bytes())
    begin = (pages["stream"] - 1) * size
    content[begin : begin + size] = b"\xaa" * size
    (tmp_path / "journal.db").write_bytes(content)
    with closing(Journal(tmp_path)) as anew:
        assert anew.set_aside is not None
        assert anew.set_aside.read_bytes() == content
        assert [one for _, one in anew.entries()] == [entry(n) for n in range(1, 400)]
        assert anew.snapshots()[0] == Snapshot(399, "E", b"state 399")
        assert len(anew.versions("E")) == 399
        assert (anew.meta("epoch"), anew.meta("epoch before")) == (None, "E"), (
            "a later line of versions begins"
        )
        assert anew.status().damaged_files == [anew.set_aside.name]
        assert anew.numbers() == {("lobby", "b1"): 399}, "there is no hole"
        anew.commit([entry(400)])
        assert kept(anew)[-1] == 400
    with closing(Journal(tmp_path)) as again:
        assert (again.set_aside, len(again)) == (None, 400)


def test_entries_that_are_missing_are_noticed(journal: Journal) -> None:
    journal.commit([entry(n) for n in range(1, 7)])
    journal._db.execute("DELETE FROM entry WHERE id IN (1, 3, 4)")
    assert list(journal.entries()) == [
        (2, entry(2)),
        (3, None),
        (4, None),
        (5, entry(5)),
        (6, entry(6)),
    ]
    assert [number for number, _ in journal.entries(after=3)] == [4, 5, 6]


@pytest.mark.parametrize("durable", [False, True])
def test_a_commit_that_raises_may_be_repeated(journal: Journal, durable: bool) -> None:
    journal.commit([entry(1)])
    journal._db = Failing(journal._db, durable)  # type: ignore[assignment]
    everything = ([entry(2), entry(3)], [version(1)], Snapshot(2, "E", b"state"))
    with pytest.raises(sqlite3.OperationalError):
        journal.commit(*everything)
    journal.commit(*everything)
    journal.commit([entry(4)])
    assert [one for _, one in journal.entries()] == [entry(n) for n in (1, 2, 3, 4)]
    assert journal.versions("E") == {1: "d1"}
    assert [one.position for one in journal.snapshots()] == [2]


def test_entries_are_forgotten_by_age_behind_both_snapshots(tmp_path: Path) -> None:
    with closing(Journal(tmp_path, KeepSettings(journal_days=2.0))) as journal:
        for day in range(6):
            journal.commit([entry(10 * day + k) for k in range(1, 11)], now=NOW + day * 86_400)
        journal.prune(NOW + 5 * 86_400)
        assert len(kept(journal)) == 60, "there is no snapshot, so all are needed"
        journal.commit([], snapshot=Snapshot(15, "E", b""))
        journal.commit([], snapshot=Snapshot(55, "E", b""))
        journal.prune(NOW + 5 * 86_400)
        assert kept(journal) == list(range(16, 61)), "up to the older snapshot"
        journal.commit([], snapshot=Snapshot(60, "E", b""))
        journal.prune(NOW + 5.5 * 86_400)
        assert kept(journal) == list(range(41, 61)), "up to the age"
        journal.commit([], snapshot=Snapshot(61, "E", b""))
        journal.prune(NOW + 50 * 86_400)
        assert kept(journal) == []
        assert journal.numbers() == {("lobby", "b1"): 60}
    with closing(Journal(tmp_path)) as again:
        again.commit([entry(61)])
        assert kept(again) == [62], "numbers are never given twice"


def test_commands_are_kept_for_ever_and_the_oldest_entry_is_another(tmp_path: Path) -> None:
    command = Entry("command", "", None, None, b"forget")
    with closing(Journal(tmp_path, KeepSettings(journal_days=2.0))) as journal:
        journal.commit([entry(1), command, entry(2)], now=NOW)
        journal.commit([entry(3)], snapshot=Snapshot(3, "E", b""), now=NOW + 9 * 86_400)
        journal.commit([], snapshot=Snapshot(4, "E", b""))
        journal.prune(NOW + 9 * 86_400)
        assert journal.commands() == [(2, NOW, command)]
        assert (journal.first(), kept(journal)) == (4, [4])


def test_a_transaction_of_any_size_is_there_as_it_was_given(tmp_path: Path) -> None:
    with closing(Journal(tmp_path)) as journal:
        given = [Entry("event", f"c{k % 130}", "b1", k, b"%d" % k) for k in range(2_345)]
        for first, last in ((0, 1), (1, 10), (10, 19), (19, 1_234), (1_234, 2_345)):
            journal.commit(given[first:last])
        assert [one for _, one in journal.entries()] == given
        assert journal.numbers() == {(f"c{k % 130}", "b1"): k for k in range(2_345)}


def test_the_file_stays_within_its_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journals, "PRUNED_ROWS_MAX", 300)
    largest = 400_000
    with closing(Journal(tmp_path, KeepSettings(journal_bytes_max=largest))) as journal:
        for block in range(60):
            many = [Entry("event", "lobby", "b1", 200 * block + k, b"x" * 100) for k in range(200)]
            journal.commit(many, now=NOW, snapshot=Snapshot(len(journal), "E", b""))
            journal.prune(NOW)
        assert (tmp_path / "journal.db").stat().st_size < 1.5 * largest
        assert len(kept(journal)) > 1000


def test_history_is_bounded_by_bytes_and_by_days(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journals, "HISTORY_BYTES_MAX", 3000)
    keep = KeepSettings(history_days=10.0)
    with closing(Journal(tmp_path, keep)) as journal:
        for day in range(8):
            content = bytes(range(256)) * (day + 1)
            journal.commit([], [version(day, content)], now=NOW + day * 86_400)
        journal.prune(NOW + 8 * 86_400)
        assert (
            sum(
                len(zlib.compress(journal.version("E", n) or b"", 3)) for n in journal.versions("E")
            )
            <= 3000
        )
        assert max(journal.versions("E")) == 7
        before = len(journal.versions("E"))
        assert before > 3
        journal.prune(NOW + 16 * 86_400)
        assert 1 < len(journal.versions("E")) < before
        journal.prune(NOW + 100 * 86_400)
        assert journal.newest_version() == bytes(range(256)) * 8, (
            "the newest stays whatever its age"
        )


def test_how_far_made_up_cameras_had_come_is_forgotten(
    journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journals, "STREAMS_KEPT_MAX", 10)
    for number in range(30):
        journal.commit([Entry("event", f"name{number}", "b1", 1, b"raw")])
    journal.prune(NOW)
    assert journal.numbers() == {(f"name{number}", "b1"): 1 for number in range(20, 30)}


def test_damage_while_it_is_open_is_noticed_at_the_next_read(
    journal: Journal, tmp_path: Path
) -> None:
    journal.commit([entry(n) for n in range(1, 2000)])
    journal._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    journal._db.execute("PRAGMA cache_size=0")
    os.truncate(tmp_path / "journal.db", (tmp_path / "journal.db").stat().st_size // 2)

    with pytest.raises(Damaged, match="a start of the program sets it aside"):
        list(journal.entries())

    journal.close()
    with closing(Journal(tmp_path)) as anew:
        assert anew.set_aside is not None
