"""The tables of a spool: their rows, and how to read them out of a damaged file."""

from __future__ import annotations

import logging
import sqlite3
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from camtopod import codec
from camtopod.records import Event
from camtopod.serve.storage import sqlite_file

log = logging.getLogger(__name__)

FORMAT = 4
"""Format of the tables; a spool of another format is refused."""
SCHEMA = """
CREATE TABLE meta (
    key TEXT PRIMARY KEY, value TEXT NOT NULL, crc INTEGER NOT NULL) WITHOUT ROWID;
CREATE TABLE mark (
    camera TEXT NOT NULL, boot TEXT NOT NULL, site TEXT NOT NULL, name TEXT NOT NULL,
    base INTEGER NOT NULL, last INTEGER NOT NULL, have INTEGER NOT NULL, crc INTEGER NOT NULL,
    PRIMARY KEY (camera, boot, site, name)) WITHOUT ROWID;
CREATE TABLE event (
    id INTEGER PRIMARY KEY, camera TEXT NOT NULL, boot TEXT NOT NULL, seq INTEGER NOT NULL,
    raw BLOB NOT NULL, crc INTEGER NOT NULL);
CREATE UNIQUE INDEX event_stream ON event (camera, boot, seq)
"""
"""The tables.

mark: how far each site has stored each (camera, boot): see `site_queue.SiteMark`.
event: the events, in the order in which they came into the spool.
"""
EventRow = tuple[str, str, int, bytes, int]
"""Columns of a numbered event: camera, boot, seq, bytes and checksum."""
INSERT = "INSERT OR IGNORE INTO event (camera, boot, seq, raw, crc) VALUES (?, ?, ?, ?, ?)"


def rescue(database: sqlite3.Connection, path: Path) -> None:
    """Copy what can be read of the newest damaged spool into the one at ``path``, if it is empty.

    Raises `sqlite3.Error`.
    """
    if database.execute("SELECT 1 FROM event").fetchone():
        return
    for aside in sqlite_file.damaged_files(path)[-1:]:
        with sqlite_file.transaction(database):
            events = copy(
                database,
                sqlite_file.readable(aside, "event", "id"),
                sqlite_file.readable(aside, "mark", "camera"),
            )
        log.error("%d events were read out of the damaged spool %s", events, aside)


def copy(
    database: sqlite3.Connection, events: Iterable[Sequence[Any]], marks: Iterable[Sequence[Any]]
) -> int:
    """Insert the undamaged rows of another spool; return the number of new events."""
    count = 0
    for _, *columns in events:
        if len(columns) == 5 and sqlite_file.sound(columns):
            count += database.execute(INSERT, columns).rowcount
    for mark in marks:
        if len(mark) == 8 and sqlite_file.sound(mark):
            database.execute("INSERT OR IGNORE INTO mark VALUES (?, ?, ?, ?, ?, ?, ?, ?)", mark)
    return count


def row(event: Event) -> EventRow:
    """Return the columns of a numbered event."""
    assert event.boot is not None
    assert event.seq is not None
    columns = event.camera, event.boot, event.seq, codec.to_msgpack(event)
    return (*columns, sqlite_file.crc(*columns))
