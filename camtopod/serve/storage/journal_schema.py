"""The tables of the journal, and writing their rows.

Every row ends with a checksum of its other columns, as SQLite does not notice a flipped bit in a
value.
"""

from __future__ import annotations

import functools
import logging
import sqlite3
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from camtopod.serve.storage.sqlite_file import crc, readable, sound
from camtopod.serve.storage.witness import JournalExtent

log = logging.getLogger(__name__)

FORMAT = 3
"""Format of the tables; a journal of another format is refused."""

_ROWS_AT_ONCE = 1_000
"""Most rows inserted by one statement.

After each statement other threads can run, and it may take long until this one continues, so there
should be few statements.
"""

ERASED_ROWS_MAX = 20_000
"""Most entries that are searched at a time for events of forgotten cameras."""
ERASED_KEY = "erased"
"""Key in ``meta``: the entry up to which forgotten cameras are to be erased, and are erased."""
NAMES_KEY = "names"
"""Key in ``meta`` of forgotten and renamed cameras; see `camtopod.serve.ingest.names`."""

SCHEMA = """
CREATE TABLE IF NOT EXISTS meta (
    key TEXT PRIMARY KEY, value TEXT NOT NULL, crc INTEGER NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS entry (
    id INTEGER PRIMARY KEY, stored INTEGER NOT NULL, kind TEXT NOT NULL, camera TEXT NOT NULL,
    boot TEXT, seq INTEGER, raw BLOB NOT NULL, crc INTEGER NOT NULL);
CREATE UNIQUE INDEX IF NOT EXISTS entry_number ON entry (camera, boot, seq) WHERE boot IS NOT NULL;
CREATE TABLE IF NOT EXISTS stream (
    camera TEXT NOT NULL, boot TEXT NOT NULL, seq INTEGER NOT NULL, entry INTEGER NOT NULL,
    crc INTEGER NOT NULL, PRIMARY KEY (camera, boot)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS version (
    id INTEGER PRIMARY KEY, epoch TEXT NOT NULL, version INTEGER NOT NULL, stored INTEGER NOT NULL,
    digest TEXT NOT NULL, size INTEGER NOT NULL, content BLOB NOT NULL, crc INTEGER NOT NULL);
CREATE UNIQUE INDEX IF NOT EXISTS version_of_epoch ON version (epoch, version);
CREATE TABLE IF NOT EXISTS snapshot (
    position INTEGER PRIMARY KEY, epoch TEXT NOT NULL, stored INTEGER NOT NULL, state BLOB NOT NULL,
    crc INTEGER NOT NULL)
"""
"""The tables.

stored (Unix seconds): when the row was stored.
stream: the highest seq of each (camera, boot), and the entry that has it.
content: the topology, compressed.
position: the last entry that a snapshot's state contains.
"""


def rescue(database: sqlite3.Connection, aside: Path) -> int:
    """Copy the undamaged rows of a journal that was set aside; return the number of entries.

    The epoch is not continued, as the next versions may differ from some that were published.
    What the publishers still have is sent again from the first hole in their numbers on, and counts
    once.
    """

    # Keep the epoch as the one before, and the names that an operator has changed.
    keys = {"epoch": "epoch before", NAMES_KEY: NAMES_KEY}
    for row in readable(aside, "meta", "key"):
        if row[0] in keys and row == meta_row(*map(str, row[:2])):
            insert(database, "INSERT OR IGNORE INTO meta", [(keys[row[0]], str(row[1]))])

    # Copy rows with the right checksum.
    entries = 0
    for table, key, columns in (
        ("entry", "id", 8),
        ("version", "id", 8),
        ("snapshot", "position", 5),
    ):
        places = ", ".join("?" * columns)
        for row in readable(aside, table, key):
            if len(row) == columns and sound(row):
                copy = f"INSERT OR IGNORE INTO {table} VALUES ({places})"
                entries += database.execute(copy, row).rowcount * (table == "entry")
    _number_again(database)
    return entries


def _number_again(database: sqlite3.Connection) -> None:
    """Store the number of each stream: that before its first hole."""
    numbers: dict[tuple[str, str], tuple[int, int]] = {}
    for camera, boot, seq, number in database.execute(
        "SELECT camera, boot, seq, id FROM entry WHERE boot IS NOT NULL ORDER BY camera, boot, seq"
    ):
        highest, _ = numbers.get((camera, boot), (0, 0))
        numbers[camera, boot] = (seq if seq == highest + 1 else highest, number)
    rows = [(*stream, *row) for stream, row in numbers.items()]
    insert(database, "INSERT OR REPLACE INTO stream", rows)


def insert(database: sqlite3.Connection, into: str, rows: Sequence[tuple[Any, ...]]) -> None:
    """Insert rows of equal length, each with its checksum; ``into``: what precedes VALUES."""
    for start in range(0, len(rows), _ROWS_AT_ONCE):
        chunk = [(*row, crc(*row)) for row in rows[start : start + _ROWS_AT_ONCE]]
        database.execute(_values(into, len(chunk[0]), len(chunk)), [*chain.from_iterable(chunk)])


def forget(database: sqlite3.Connection, cameras: Mapping[str, int]) -> bool:
    """Delete some of what is kept of forgotten cameras; return True if more is left.

    cameras: by name, the entry up to which nothing is kept.

    Of their events the numbers stay. Nothing is deleted before a state is kept that was made after
    the last of these entries; then older states, which contain cameras, are deleted as well.
    """
    command = max(cameras.values())
    newest = database.execute("SELECT MAX(position) FROM snapshot").fetchone()[0] or 0
    if newest < command:
        return False
    last, _, erased = (read_meta(database, ERASED_KEY) or "").partition(" ")
    after = int(erased) if last == str(command) else 0
    if after >= command:
        return False

    until = min(after + ERASED_ROWS_MAX, command)
    rows = database.execute(
        "SELECT id, stored, camera, boot, seq FROM entry WHERE id > ? AND id <= ? AND raw <> x''"
        f" AND camera IN ({', '.join('?' * len(cameras))})",
        (after, until, *cameras),
    ).fetchall()
    numbers = [(*row[:2], "refused", *row[2:], b"") for row in rows if row[0] <= cameras[row[2]]]
    insert(database, "INSERT OR REPLACE INTO entry", numbers)
    database.execute("DELETE FROM snapshot WHERE position < ?", (command,))
    write_meta(database, ERASED_KEY, f"{command} {until}")
    return bool(until < command)


@functools.cache
def _values(into: str, columns: int, rows: int) -> str:
    """Return the statement that inserts ``rows`` rows of ``columns`` columns."""
    row = f"({', '.join('?' * columns)})"
    return f"{into} VALUES {', '.join([row] * rows)}"


def insert_large(database: sqlite3.Connection, into: str, row: tuple[Any, ...]) -> None:
    """Insert one large row with its checksum, and keep no copy of it.

    SQLite keeps the statement, with its last values, for the next row; so it is executed again with
    NULLs, which inserts nothing.
    """
    for values in ((*row, crc(*row)), (None,) * (len(row) + 1)):
        database.execute(
            f"{into} SELECT {', '.join('?' * len(values))} WHERE ?1 IS NOT NULL", values
        )


def meta_row(key: str, value: str) -> tuple[str, str, int]:
    """Return a row of the table ``meta``."""
    return key, value, crc(key, value)


def read_meta(database: sqlite3.Connection, key: str) -> str | None:
    """Return a value of ``meta``; None if there is none or it is damaged."""
    row = database.execute("SELECT key, value, crc FROM meta WHERE key = ?", (key,)).fetchone()
    if row is not None and row != meta_row(*row[:2]):
        log.error("the journal's %s is damaged and not used", key)
        return None
    return None if row is None else str(row[1])


def write_meta(database: sqlite3.Connection, key: str, value: str) -> None:
    """Store a value in ``meta``."""
    insert(database, "INSERT OR REPLACE INTO meta", [(key, value)])


def last_entry(database: sqlite3.Connection) -> int:
    """Return the number of the newest entry.

    All entries may have been deleted, but never those after the newest snapshot, so its position
    counts, too.
    """
    return int(
        database.execute(
            "SELECT MAX((SELECT COALESCE(MAX(id), 0) FROM entry),"
            " (SELECT COALESCE(MAX(position), 0) FROM snapshot))"
        ).fetchone()[0]
    )


def last_version(database: sqlite3.Connection) -> int:
    """Return the number of the newest version, counted over all epochs."""
    return int(database.execute("SELECT COALESCE(MAX(id), 0) FROM version").fetchone()[0])


def how_far(database: sqlite3.Connection) -> JournalExtent:
    """Return how far the journal has come."""
    epoch = max(read_meta(database, key) or "" for key in ("epoch", "epoch before"))
    return JournalExtent(last_entry(database), last_version(database), epoch)
