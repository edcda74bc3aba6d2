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
from paths import ROOT

from camtopod.serve.storage.journal import Entry, Journal, Snapshot, StoredVersion
from camtopod.serve.storage.sqlite_file import Displaced

Harm = Callable[[Path], object]


def entries(*numbers: int) -> list[Entry]:
    return [Entry("event", "lobby", "b1", number, b"raw %d" % number) for number in numbers]


def kept(journal: Journal) -> list[int | None]:
    return [entry.seq for _, entry in journal.entries() if entry is not None]


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with closing(Journal(tmp_path)) as one:
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


HARMS: dict[str, Harm] = {"removed": os.unlink, "moved": move, "replaced": replace}


@pytest.mark.parametrize("name", HARMS)
def test_a_journal_that_is_gone_stores_nothing_more(
    journal: Journal, tmp_path: Path, name: str
) -> None:
    journal.commit([])
    HARMS[name](tmp_path / "journal.db")

    with pytest.raises(Displaced, match="was removed or replaced while it is in use"):
        journal.commit([])  # noticed though there is nothing to store
    with pytest.raises(Displaced):
        journal.commit(entries(4, 5))
    with pytest.raises(Displaced):
        journal.set_meta("key", "value")
    assert len(journal) == 3


class Harmed:
    """A connection to whose file something happens just before a transaction is checked."""

    def __init__(self, connection: sqlite3.Connection, harm: Callable[[], object]) -> None:
        self._connection = connection
        self._harm = harm

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)

    def execute(self, statement: str, *parameters: object) -> Any:
        if statement == "BEGIN IMMEDIATE":
            self._harm()
        return self._connection.execute(statement, *parameters)


def test_the_same_commit_succeeds_once_the_file_is_back(journal: Journal, tmp_path: Path) -> None:
    path, moved = tmp_path / "journal.db", tmp_path / "moved"
    everything = (
        entries(4, 5),
        [StoredVersion("E", 1, "sha256:1", b"{}")],
        Snapshot(5, "E", b"state"),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(journal, "_db", Harmed(journal._db, lambda: path.rename(moved)))
        for _ in range(2):
            with pytest.raises(Displaced):
                journal.commit(*everything)

    moved.rename(path)
    journal.commit(*everything)
    journal.commit(entries(6))

    assert kept(journal) == [1, 2, 3, 4, 5, 6]
    assert journal.versions("E") == {1: "sha256:1"}


# --- what is found at the next start --------------------------------------------------------------


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
        assert again.missing == (2 if lost == "entries" else 0)
        assert again.status().missing == again.missing
    assert caplog.text.count("has come back older than it was") == 1
    caplog.clear()
    with closing(Journal(tmp_path)) as later:
        assert (len(later), later.missing, later.meta("epoch")) == (3, 0, None)
    assert "older" not in caplog.text, "it is said once"


@pytest.mark.parametrize("line", [b"", b"\0" * 105])
def test_a_witness_that_cannot_be_read_says_nothing(
    journal: Journal, tmp_path: Path, line: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    """As after a power cut: it is never synced."""
    journal.close()
    (tmp_path / "journal.lock").write_bytes(line)
    with closing(Journal(tmp_path)) as again:
        assert (len(again), again.missing, again.meta("epoch")) == (3, 0, "E")
        again.commit(entries(4))
    for path in tmp_path.glob("journal.db*"):
        path.unlink()
    with closing(Journal(tmp_path)) as empty:
        assert empty.missing == 4
    assert caplog.text.count("has come back older than it was: it had 4 entries and has 0") == 1


def test_a_damaged_witness_says_nothing(journal: Journal, tmp_path: Path) -> None:
    """Not even an epoch that no clock has ever given, or a number that no journal reaches."""
    journal.close()
    path = tmp_path / "journal.lock"
    line = path.read_bytes()
    for place in range(len(line)):
        path.write_bytes(line[:place] + b"~" + line[place + 1 :])
        with closing(Journal(tmp_path)) as again:
            assert (again.missing, again.meta("epoch"), again.meta("epoch before")) == (
                0,
                "E",
                None,
            )
    path.write_bytes(line.replace(b"3", b"3" * 30, 1))
    with closing(Journal(tmp_path)) as again:
        assert (again.missing, again.meta("epoch")) == (0, "E")


def test_damage_that_sqlite_quotes_is_noticed_though_it_is_no_text(tmp_path: Path) -> None:
    with closing(Journal(tmp_path)) as journal:
        journal.commit([Entry("event", "lobby", "b1", 1, b"raw")])
    path = tmp_path / "journal.db"
    content = path.read_bytes()
    assert b"tablesnapshotsnapshot" in content
    content = content.replace(b"tablesnapshotsnapshot", b"tablesnap\xe1hotsnapshot")
    path.write_bytes(content.replace(b"CREATE TABLE snapshot", b"CREATE XABLE snapshot"))

    with closing(Journal(tmp_path)) as anew:
        assert anew.set_aside is not None


# --- the lock, and children that share it ---------------------------------------------------------

FORKING = """
import os, signal, sys
from pathlib import Path

slow = []
os.register_at_fork(after_in_child=lambda: slow and signal.pause())  # before the lock's own
from camtopod.serve.storage.sqlite_file import Lock, StateError

path = Path(sys.argv[1])
lock = Lock(path)
child = os.fork()
if child == 0:
    os._exit(0)
os.waitpid(child, 0)
try:
    Lock(path)
except StateError:
    print("held")

slow.append(True)
child = os.fork()  # it never comes to leaving the lock
try:
    lock.close()
    Lock(path).close()
    print("free")
finally:
    os.kill(child, signal.SIGKILL)
"""


def test_a_lock_is_its_openers_until_it_is_closed_whatever_children_do(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FORKING, str(tmp_path / "lock")],
        capture_output=True,
        cwd=ROOT,
        text=True,
    )

    assert (done.stdout, done.stderr) == ("held\nfree\n", "")
