"""The tables of a spool: create and check them, and read them out of a damaged file."""

from __future__ import annotations

import contextlib
import logging
import sqlite3
from pathlib import Path
from typing import NamedTuple

from camtopod.serve.storage import sqlite_file

log = logging.getLogger(__name__)

FORMAT = 2
"""Format of the tables; a spool of another format is refused."""

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


class Opened(NamedTuple):
    """An open spool; ``rescued``: number of events read out of a damaged file just now."""

    connection: sqlite3.Connection
    rescued: int


def open_file(path: Path) -> Opened:
    """Open or create a spool's file. Raises `sqlite_file.StateError` and `sqlite3.Error`.

    An existing file is not written to, so that it can be opened on a full disk.
    """
    connection, _ = sqlite_file.connect_or_recreate(
        path, SCHEMA, FORMAT, needed_tables=("meta", "count", "acked")
    )
    with contextlib.ExitStack() as undo:
        undo.callback(connection.close)
        rescued = 0
        for aside in sqlite_file.damaged_files(path)[-1:]:
            if meta(connection, "rescued") != aside.name:
                with sqlite_file.transaction(connection):
                    rescued = _rescue(connection, aside)
                    set_row(connection, "meta", "rescued", aside.name)
                log.error("%d events were read out of the damaged spool %s", rescued, aside)
        undo.pop_all()
    return Opened(connection, rescued)


def write_boot(connection: sqlite3.Connection, boot: str) -> None:
    """Write a new boot with its first events, and restart the counts."""
    connection.execute("DELETE FROM count")
    for key, value in (("boot", boot), ("closed", "no")):
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
