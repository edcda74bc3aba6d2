"""The tables of the journal, and the migration of older ones.

Every row ends with a checksum of its other columns, as SQLite does not notice a flipped bit in a
value.
"""

from __future__ import annotations

import logging
import sqlite3
import zlib
from pathlib import Path

from camtopod.serve.storage.sqlite_file import Damaged, StateError, crc, readable
from camtopod.serve.storage.witness import JournalExtent

log = logging.getLogger(__name__)

FORMAT = 2
"""Format of the tables; an older one is migrated, a newer one refused."""

NAMES_KEY = "names"
"""Key in ``meta`` of forgotten and renamed cameras; see `camtopod.serve.ingest.names`."""

DAMAGED = -1
"""A value that no checksum has: given to rows that were damaged before the migration."""

SCHEMA = """
CREATE TABLE IF NOT EXISTS meta (
    key TEXT PRIMARY KEY, value TEXT NOT NULL, crc INTEGER NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS entry (
    id INTEGER PRIMARY KEY, stored INTEGER NOT NULL, kind TEXT NOT NULL, camera TEXT NOT NULL,
    boot TEXT, seq INTEGER, raw BLOB NOT NULL, crc INTEGER NOT NULL);
CREATE INDEX IF NOT EXISTS entry_number ON entry (camera, boot, seq) WHERE boot IS NOT NULL;
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
content: the topology, compressed; empty if only its digest is known.
position: the last entry that a snapshot's state contains.
"""


def prepare(database: sqlite3.Connection) -> None:
    """Create the tables, or migrate those of an older program.

    Raises `StateError` for those of a newer program, and `Damaged` if the format is unreadable.
    """
    tables = {
        name for (name,) in database.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")
    }
    if "meta" not in tables:
        create(database)
        return
    row = database.execute("SELECT * FROM meta WHERE key = 'format'").fetchone()
    if row is None or (len(row) > 2 and row != meta_row(*row[:2])):
        raise Damaged("the journal is damaged: it does not say its format")
    if row[1] == "1":
        _from_1(database)
    elif row[1] != str(FORMAT):
        raise StateError(
            f"the journal has format {row[1]}, this program {FORMAT}: use the one that wrote it"
        )


def create(database: sqlite3.Connection) -> None:
    """Create the tables and store their format, within the caller's transaction."""
    for statement in SCHEMA.split(";"):
        database.execute(statement)
    database.execute("INSERT INTO meta VALUES (?, ?, ?)", meta_row("format", str(FORMAT)))


def rescue(database: sqlite3.Connection, aside: Path) -> int:
    """Copy what is undamaged in a journal that was set aside; return the number of entries.

    The epoch is not continued, as the next versions may differ from some that were published.
    Stored sequence numbers are not copied: what the publishers still have is sent again, fills the
    gaps, and counts once.
    """

    # Keep the epoch as the one before, and the names that an operator has changed.
    kept = {"epoch": "epoch before", NAMES_KEY: NAMES_KEY}
    for row in readable(aside, "meta", "key"):
        if row[0] in kept and row == meta_row(*map(str, row[:2])):
            database.execute(
                "INSERT OR IGNORE INTO meta VALUES (?, ?, ?)", meta_row(kept[row[0]], str(row[1]))
            )

    # Copy rows with the right checksum.
    entries = 0
    for table, key, columns in (
        ("entry", "id", 8),
        ("version", "id", 8),
        ("snapshot", "position", 5),
    ):
        places = ", ".join("?" * columns)
        for row in readable(aside, table, key):
            if len(row) == columns and crc(*row[:-1]) == row[-1]:
                added = database.execute(
                    f"INSERT OR IGNORE INTO {table} VALUES ({places})", row
                ).rowcount
                entries += added if table == "entry" else 0
    return entries


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
    database.execute("INSERT OR REPLACE INTO meta VALUES (?, ?, ?)", meta_row(key, value))


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
    return JournalExtent(
        last_entry(database), last_version(database), epoch, read_meta(database, "name") or ""
    )


def prepare_new_epoch(database: sqlite3.Connection, known: JournalExtent) -> None:
    """Prepare a journal that was set back for a new epoch, within the caller's transaction.

    Its own epoch ends, as published versions may be missing; the next one sorts after it and after
    the newest that is known.
    """
    found = how_far(database)
    database.execute("DELETE FROM meta WHERE key = 'epoch'")
    write_meta(database, "epoch before", max(found.epoch, known.epoch))
    if known.name and not found.name:
        write_meta(database, "name", known.name)


def _from_1(database: sqlite3.Connection) -> None:
    """Migrate format 1, which had no times, kept every entry, and only digests of versions.

    Its digests are of the current epoch.
    """

    # Create the new tables beside the old ones.
    for table in ("meta", "entry", "version"):
        database.execute(f"ALTER TABLE {table} RENAME TO old_{table}")
    database.execute("DROP INDEX entry_stream")
    for statement in SCHEMA.split(";"):
        database.execute(statement)

    # Copy the values, with checksums.
    meta = dict(database.execute("SELECT key, value FROM old_meta")) | {"format": str(FORMAT)}
    database.executemany(
        "INSERT INTO meta VALUES (?, ?, ?)", [meta_row(*item) for item in meta.items()]
    )

    # Copy the entries; the time is 0, and damaged ones stay marked as damaged.
    entries = database.execute("SELECT * FROM old_entry ORDER BY id")
    database.executemany(
        "INSERT INTO entry VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
        (
            (
                *row[:1],
                0,
                *row[1:6],
                crc(row[0], 0, *row[1:6]) if zlib.crc32(row[5]) == row[6] else DAMAGED,
            )
            for row in entries
        ),
    )

    # Derive the streams.
    newest = database.execute(
        "SELECT camera, boot, MAX(seq), MAX(id) FROM entry"
        " WHERE boot IS NOT NULL GROUP BY camera, boot"
    ).fetchall()
    database.executemany(
        "INSERT INTO stream VALUES (?, ?, ?, ?, ?)", [(*row, crc(*row)) for row in newest]
    )

    # Copy the digests of versions.
    digests = database.execute(
        "SELECT version, digest FROM old_version ORDER BY version"
    ).fetchall()
    rows = [
        (n, meta.get("epoch", ""), version, 0, digest, 0, b"")
        for n, (version, digest) in enumerate(digests, 1)
    ]
    database.executemany(
        "INSERT INTO version VALUES (?, ?, ?, ?, ?, ?, ?, ?)", [(*row, crc(*row)) for row in rows]
    )

    # Delete the old tables.
    for table in ("meta", "entry", "version"):
        database.execute(f"DROP TABLE old_{table}")
