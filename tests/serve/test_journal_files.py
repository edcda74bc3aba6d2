"""The journal's open files are not those in the folder: noticed before an event counts as stored.

The witness file beside the journal shows that an older journal has come back.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage import sqlite_file
from camtopod.serve.storage.journal import Entry, Journal, Snapshot, StoredVersion
from camtopod.serve.storage.open_files import Displaced

SCHEMA = "CREATE TABLE IF NOT EXISTS one (id INTEGER PRIMARY KEY)"
Harm = Callable[[Path], None]


def entries(*numbers: int) -> list[Entry]:
    return [Entry("event", "lobby", "b1", number, b"raw %d" % number) for number in numbers]


def kept(journal: Journal) -> list[int | None]:
    return [entry.seq for _, entry in journal.entries() if entry is not None]


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with closing(Journal(tmp_path)) as one:
        one.set_meta("name", "N")
        one.set_meta("epoch", "E")
        one.commit(entries(1, 2, 3))
        yield one


def copy_of(directory: Path, target: Path) -> Path:
    """Copy the journal as a kill leaves it."""
    return shutil.copytree(directory, target)


def replace(path: Path) -> None:
    path.with_name("copy").write_bytes(path.read_bytes())
    path.with_name("copy").rename(path)


def move(path: Path) -> None:
    path.rename(path.with_name("moved"))


HARMS: dict[str, tuple[str, Harm]] = {
    "journal removed": ("journal.db", os.unlink),
    "journal moved": ("journal.db", move),
    "journal replaced": ("journal.db", replace),
    "journal cut": ("journal.db", lambda path: os.truncate(path, 0)),
    "log removed": ("journal.db-wal", os.unlink),
    "log replaced": ("journal.db-wal", replace),
    "log cut": ("journal.db-wal", lambda path: os.truncate(path, 0)),
    "lock removed": ("journal.lock", os.unlink),
    "lock replaced": ("journal.lock", replace),
}


@pytest.fixture(params=HARMS)
def harm(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[], None]:
    """Harm to a file, and a function that does it."""
    name, happens = HARMS[request.param]
    return lambda: happens(tmp_path / name)


# --- what is noticed ------------------------------------------------------------------------------


def test_it_is_noticed_though_there_is_nothing_to_store(
    journal: Journal, harm: Callable[[], None]
) -> None:
    journal.commit([])
    harm()
    for _ in range(2):
        with pytest.raises(Displaced, match="while it is in use"):
            journal.commit([])
    with pytest.raises(Displaced):
        journal.set_meta("key", "value")
    with pytest.raises(Displaced):
        journal.prune(0.0)


class Harmed:
    """A connection to whose files something happens just before or after a COMMIT takes effect."""

    def __init__(
        self, connection: sqlite3.Connection, harm: Callable[[], None], after: bool
    ) -> None:
        self._connection, self._harm, self._after = connection, harm, after

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)

    def execute(self, statement: str, *parameters: object) -> Any:
        if statement == "COMMIT" and not self._after:
            self._harm()
        done = self._connection.execute(statement, *parameters)
        if statement == "COMMIT" and self._after:
            self._harm()
        return done


@pytest.mark.parametrize("after", [False, True])
def test_what_is_committed_into_a_file_that_is_gone_is_not_stored(
    journal: Journal, harm: Callable[[], None], after: bool
) -> None:
    """The file goes during the transaction."""
    journal._db = Harmed(journal._db, harm, after)  # type: ignore[assignment]
    with pytest.raises(Displaced, match="while it is in use"):
        journal.commit(entries(4, 5))
    assert len(journal) == 3


def test_what_was_committed_counts_when_the_file_is_back(journal: Journal, tmp_path: Path) -> None:
    path, moved = tmp_path / "journal.db", tmp_path / "moved"
    everything = (
        entries(4, 5),
        [StoredVersion("E", 1, "sha256:1", b"{}")],
        Snapshot(5, "E", b"state"),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(journal, "_db", Harmed(journal._db, lambda: path.rename(moved), True))
        for _ in range(3):
            with pytest.raises(Displaced):
                journal.commit(*everything)
    moved.rename(path)
    journal.commit(*everything)
    journal.commit(entries(6))
    assert kept(journal) == [1, 2, 3, 4, 5, 6]
    assert journal.versions("E") == {1: "sha256:1"}


def in_another_process(statement: str, path: Path) -> None:
    code = "import sqlite3, sys; db = sqlite3.connect(sys.argv[1]); print(db.execute(sys.argv[2]).fetchall()); db.commit()"
    subprocess.run(
        [sys.executable, "-c", code, str(path), statement],
        check=True,
        timeout=60,
        stdout=subprocess.DEVNULL,
    )


@pytest.mark.parametrize(
    "statement",
    [
        "SELECT COUNT(*) FROM entry",
        "PRAGMA wal_checkpoint(PASSIVE)",
        "PRAGMA wal_checkpoint(TRUNCATE)",
        "VACUUM INTO 'TARGET'",
    ],
)
def test_another_program_may_read_it_and_fold_its_log_in(
    journal: Journal, tmp_path: Path, statement: str
) -> None:
    """As `sqlite3` does, or a backup of a database in use."""
    for number in range(4, 400, 3):
        journal.commit(entries(number, number + 1, number + 2))
        if number % 30 == 4:
            target = str(tmp_path / f"backup-{number}")
            in_another_process(statement.replace("TARGET", target), tmp_path / "journal.db")
            journal.commit([])
    os.utime(tmp_path / "journal.db")
    os.chmod(tmp_path / "journal.lock", 0o640)
    journal.commit([])
    assert len(kept(journal)) == len(journal) == 399


def test_entries_of_another_program_are_no_reason_to_count_ones_own_as_stored(
    journal: Journal, tmp_path: Path
) -> None:
    """There are as many as ours, which after a failed transaction may look as if it
    had succeeded.
    """
    (tmp_path / "journal.lock").rename(tmp_path / "lock")
    with closing(Journal(tmp_path)) as other:
        other.commit(entries(10, 11))
    (tmp_path / "lock").rename(tmp_path / "journal.lock")
    with pytest.raises(
        Displaced, match="was changed by another program, its last entry is 5 and was 3"
    ):
        journal.commit(entries(4, 5))


def test_any_database_can_be_asked(tmp_path: Path) -> None:
    """Also a spool's."""
    with closing(sqlite_file.connect(tmp_path / "one.db", SCHEMA)) as connection:
        connection.check()
        connection.execute("INSERT INTO one VALUES (1)")
        connection.check()
        (tmp_path / "one.db").unlink()
        with pytest.raises(
            Displaced, match=r"one\.db is gone while it is in use \(No such file or directory\)"
        ):
            connection.check()


# --- what is found at the next start --------------------------------------------------------------


def test_a_journal_that_is_gone_leaves_its_log_to_be_looked_at(
    journal: Journal, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """SQLite would delete the log silently."""
    killed = copy_of(tmp_path, tmp_path / "killed")
    (killed / "journal.db").unlink()
    content = (killed / "journal.db-wal").read_bytes()
    with closing(Journal(killed)) as again:
        assert (len(again), again.missing) == (0, 3)
        assert (killed / "journal.db.damaged-1-wal").read_bytes() == content
        again.commit(entries(1, 2, 3))
    assert (
        "journal.db is damaged: it is empty or was missing, and its log is still there"
        in caplog.text
    )
    assert "has come back older than it was: it had 3 entries and has 0" in caplog.text


def test_a_spool_that_is_gone_leaves_its_log_to_be_looked_at(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "spool").mkdir()
    with closing(Spool(tmp_path / "spool" / "spool.db", "boot-1", 1000)):
        killed = copy_of(tmp_path / "spool", tmp_path / "killed")
    (killed / "spool.db").unlink()
    (killed / "spool.db-wal").write_bytes(b"x" * 100)
    with closing(Spool(killed / "spool.db", "boot-2", 1000)) as again:
        assert again.statistics()["damaged_files"] == 1
    assert "spool.db is damaged: it is empty or was missing" in caplog.text


def as_it_was(tmp_path: Path, earlier: Path) -> None:
    """Put the database of an earlier day beside the witness of today."""
    for path in tmp_path.glob("journal.db*"):
        path.unlink()
    for path in earlier.glob("journal.db*"):
        shutil.copyfile(path, tmp_path / path.name)


@pytest.mark.parametrize("lost", ["entries", "versions", "epoch"])
def test_a_journal_that_came_back_older_begins_a_later_epoch(
    journal: Journal, tmp_path: Path, lost: str, caplog: pytest.LogCaptureFixture
) -> None:
    earlier = copy_of(tmp_path, tmp_path / "earlier")
    if lost == "entries":
        journal.commit(entries(4, 5))
    elif lost == "versions":
        journal.commit([], [StoredVersion("E", 1, "sha256:1", b"{}")])
    else:
        journal.set_meta("epoch", "F")
    journal.close()
    as_it_was(tmp_path, earlier)
    with closing(Journal(tmp_path)) as again:
        assert (again.meta("epoch"), again.meta("epoch before")) == (
            None,
            "F" if lost == "epoch" else "E",
        )
        assert (again.meta("name"), again.missing) == ("N", 2 if lost == "entries" else 0)
        assert again.status()["missing"] == again.missing
    assert caplog.text.count("has come back older than it was") == 1
    caplog.clear()
    with closing(Journal(tmp_path)) as later:
        assert (len(later), later.missing, later.meta("epoch")) == (3, 0, None)
    assert "older" not in caplog.text, "it is said once"


def test_everything_but_the_witness_is_lost(journal: Journal, tmp_path: Path) -> None:
    journal.commit([], snapshot=Snapshot(3, "E", b"state"))
    journal.close()
    for path in tmp_path.glob("journal.db*"):
        path.unlink()
    with closing(Journal(tmp_path)) as again:
        assert (again.meta("name"), again.meta("epoch"), again.meta("epoch before")) == (
            "N",
            None,
            "E",
        )
        assert (len(again), again.missing) == (0, 3)


@pytest.mark.parametrize("line", [b"", b"\0" * 105, b"x" * 300, None])
def test_a_witness_that_cannot_be_read_says_nothing(
    journal: Journal, tmp_path: Path, line: bytes | None, caplog: pytest.LogCaptureFixture
) -> None:
    """As after a power cut: it is never synced."""
    journal.close()
    content = bytearray((tmp_path / "journal.lock").read_bytes())
    content[19] ^= 1  # how many entries
    (tmp_path / "journal.lock").write_bytes(content if line is None else line)
    with closing(Journal(tmp_path)) as again:
        assert (len(again), again.missing, again.meta("epoch"), again.meta("name")) == (
            3,
            0,
            "E",
            "N",
        )
        again.commit(entries(4))
    for path in tmp_path.glob("journal.db*"):
        path.unlink()
    with closing(Journal(tmp_path)) as empty:
        assert empty.missing == 4
    assert caplog.text.count("has come back older than it was: it had 4 entries and has 0") == 1


def test_a_witness_that_cannot_be_written_stops_nothing(
    journal: Journal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> int:
        raise OSError("No space left on device")

    monkeypatch.setattr(os, "pwrite", full)
    journal.commit(entries(4))
    assert kept(journal) == [1, 2, 3, 4]
