"""The tables of a spool: create, migrate and check them, and read them out of a damaged file."""

from __future__ import annotations

import contextlib
import logging
import sqlite3
from pathlib import Path
from typing import NamedTuple

from camtopod.serve.storage import sqlite_file

log = logging.getLogger(__name__)

FORMAT = 2
"""Format of the tables; an older one is migrated, a newer one refused."""

SCHEMA = """
CREATE TABLE IF NOT EXISTS meta (
    key TEXT PRIMARY KEY, value TEXT NOT NULL, crc INTEGER NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS count (
    camera TEXT PRIMARY KEY, seq INTEGER NOT NULL, crc INTEGER NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS acked (
    camera TEXT NOT NULL, boot TEXT NOT NULL, seq INTEGER NOT NULL, crc INTEGER NOT NULL,
    PRIMARY KEY (camera, boot)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS event (
    id INTEGER PRIMARY KEY AUTOINCREMENT, camera TEXT NOT NULL, boot TEXT NOT NULL,
    seq INTEGER NOT NULL, raw BLOB NOT NULL, crc INTEGER NOT NULL);
CREATE UNIQUE INDEX IF NOT EXISTS event_stream ON event (camera, boot, seq)
"""
"""The tables.

count: the highest seq given to each camera in the current boot.
acked: the highest acknowledged seq of each (camera, boot).
event: the events, in the order in which they were stored.
"""
_SMALL_TABLES = ("meta", "count", "acked")


class Opened(NamedTuple):
    """An open spool; ``rescued``: number of events read out of a damaged file just now."""

    connection: sqlite3.Connection
    rescued: int


def open_file(path: Path) -> Opened:
    """Open or create a spool's file. Raises `sqlite_file.StateError` and `sqlite3.Error`.

    An existing file is not written to, so that it can be opened on a full disk.
    """
    connection, _ = sqlite_file.connect_or_recreate(path, SCHEMA, _prepare)
    with contextlib.ExitStack() as undo:
        undo.callback(connection.close)
        rescued = 0
        for aside in sqlite_file.damaged_files(path)[-1:]:
            if meta(connection, "rescued") != aside.name:
                with sqlite_file.transaction(connection):
                    rescued = _rescue(connection, aside)
                    set_row(connection, "meta", "rescued", aside.name)
                    set_row(connection, "meta", "format", str(FORMAT))
                log.error("%d events were read out of the damaged spool %s", rescued, aside)
        undo.pop_all()
    return Opened(connection, rescued)


def write_boot(connection: sqlite3.Connection, boot: str) -> None:
    """Write a new boot with its first events, and restart the counts."""
    connection.execute("DELETE FROM count")
    for key, value in (("format", str(FORMAT)), ("boot", boot), ("closed", "no")):
        set_row(connection, "meta", key, value)


def meta(connection: sqlite3.Connection, key: str) -> str | None:
    """Return a value of the table ``meta``."""
    row = connection.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
    return None if row is None else str(row[0])


def counts(connection: sqlite3.Connection) -> dict[str, int]:
    """Return the highest seq given to each camera in the current boot."""
    return dict(connection.execute("SELECT camera, seq FROM count"))


def acked(connection: sqlite3.Connection) -> dict[tuple[str, str], int]:
    """Return the highest acknowledged seq of each (camera, boot)."""
    return {
        (camera, boot): seq
        for camera, boot, seq in connection.execute("SELECT camera, boot, seq FROM acked")
    }


def set_row(connection: sqlite3.Connection, table: str, *columns: str | int) -> None:
    """Insert or replace a row of one of the small tables."""
    marks = "?, " * len(columns)
    connection.execute(
        f"INSERT OR REPLACE INTO {table} VALUES ({marks}?)", (*columns, sqlite_file.crc(*columns))
    )


def _prepare(connection: sqlite3.Connection) -> None:
    """Check an existing file and migrate it to this format. Raises `sqlite_file.StateError`."""

    names = {
        row[0] for row in connection.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")
    }
    if not names:
        return

    # Migrate format 1, which has no checksums.
    columns = {row[0] for row in connection.execute("SELECT name FROM pragma_table_info('meta')")}
    if columns == {"key", "value"}:
        _from_format_1(connection)
        return
    if "crc" not in columns:
        raise sqlite_file.Damaged("the spool has no table meta")

    # Check the format.
    _check(connection, "meta")
    found = connection.execute("SELECT value FROM meta WHERE key = 'format'").fetchone()
    if found is None:
        if connection.execute("SELECT COUNT(*) FROM meta").fetchone()[0]:
            raise sqlite_file.Damaged("the spool does not say which format it has")
    elif int(found[0]) > FORMAT:
        raise sqlite_file.StateError(
            f"the spool has format {found[0]}, this program {FORMAT}: "
            f"use the one that wrote it, or move the file away"
        )

    # Check the rows of the small tables.
    for table in _SMALL_TABLES:
        _check(connection, table)


def _check(connection: sqlite3.Connection, table: str) -> None:
    """Raise `Damaged` if a row of ``table`` has a wrong checksum."""
    for *columns, crc in connection.execute(f"SELECT * FROM {table}"):
        if sqlite_file.crc(*columns) != crc:
            raise sqlite_file.Damaged(f"a row of the spool's table {table} is damaged")


def _from_format_1(connection: sqlite3.Connection) -> None:
    """Migrate format 1, which had no checksums and kept no acknowledged events."""
    tables = ("meta", "count", "event")
    connection.execute("DROP INDEX event_stream")
    for table in tables:
        connection.execute(f"ALTER TABLE {table} RENAME TO {table}_1")
    for statement in SCHEMA.split(";"):
        connection.execute(statement)
    for key, value in connection.execute("SELECT key, value FROM meta_1").fetchall():
        set_row(connection, "meta", key, value)
    for camera, seq in connection.execute("SELECT camera, seq FROM count_1").fetchall():
        set_row(connection, "count", camera, seq)
    connection.executemany(
        "INSERT INTO event VALUES (?, ?, ?, ?, ?, ?)",
        (
            (*row, sqlite_file.crc(*row[1:]))
            for row in connection.execute("SELECT * FROM event_1 ORDER BY id")
        ),
    )
    for table in tables:
        connection.execute(f"DROP TABLE {table}_1")


def _rescue(connection: sqlite3.Connection, aside: Path) -> int:
    """Copy the undamaged rows of a damaged file; return the number of events."""
    events = 0
    for row in sqlite_file.readable(aside, "event", "id"):
        if len(row) == 6 and sqlite_file.crc(*row[1:-1]) == row[-1]:
            events += connection.execute(
                "INSERT OR IGNORE INTO event VALUES (?, ?, ?, ?, ?, ?)", row
            ).rowcount
    for row in sqlite_file.readable(aside, "acked", "camera"):
        if len(row) == 4 and sqlite_file.crc(*row[:-1]) == row[-1]:
            connection.execute("INSERT OR REPLACE INTO acked VALUES (?, ?, ?, ?)", row)
    return events
