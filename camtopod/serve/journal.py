"""The daemon's journal: what was received, in the order it was learned, and the versions it led to.

One SQLite database, one connection, one thread. An entry is the bytes as received and their CRC; replaying
the entries in order through the learner gives the same versions with the same digests. An event is
acknowledged only after its transaction is committed; a version is published only after its digest is stored.
"""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from camtopod.serve import database

FORMAT = 1
"""Of the database's tables; another one is refused, never thrown away."""

_SCHEMA = """
CREATE TABLE IF NOT EXISTS meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS entry (
    id INTEGER PRIMARY KEY, kind TEXT NOT NULL, camera TEXT NOT NULL, boot TEXT, seq INTEGER,
    raw BLOB NOT NULL, crc INTEGER NOT NULL);
CREATE INDEX IF NOT EXISTS entry_stream ON entry (camera, boot, seq) WHERE boot IS NOT NULL;
CREATE TABLE IF NOT EXISTS version (version INTEGER PRIMARY KEY, digest TEXT NOT NULL);
"""

EntryKind = Literal["event", "future", "refused", "advance"]
"""``event``: learned. ``future``, ``refused``: kept for the record and for the sequence, not learned.
``advance``: event time went on without an event; ``raw`` is the time as decimal text."""


class Entry(NamedTuple):
    """One row: what happened next."""

    kind: EntryKind
    camera: str
    boot: str | None
    seq: int | None
    raw: bytes


class Journal:
    """All calls from one thread at a time. Raises `database.StateError` if the directory cannot be used."""

    def __init__(self, directory: Path, versions_kept: int) -> None:
        self._lock = database.Lock(directory / "journal.lock")
        self._path = directory / "journal.db"
        self._versions_kept = versions_kept
        try:
            self._db = database.connect(self._path, _SCHEMA)
            found = self.meta("format")
            if found is None:
                self.set_meta("format", str(FORMAT))
            elif found != str(FORMAT):
                raise database.StateError(
                    f"{self._path} has format {found}, this program {FORMAT}: use the one that wrote it"
                )
            self._last = self._stored_last()
        except sqlite3.Error as error:
            self._lock.close()
            raise database.StateError(f"cannot read {self._path}: {error}; it is left as it is") from None
        except database.StateError:
            self._lock.close()
            raise

    def meta(self, key: str) -> str | None:
        """A value kept by `set_meta`."""
        row = self._db.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
        return None if row is None else str(row[0])

    def set_meta(self, key: str, value: str) -> None:
        """Keep a value."""
        self._db.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", (key, value))

    def commit(self, entries: Sequence[Entry], versions: Sequence[tuple[int, str]] = ()) -> None:
        """Store all of it in one transaction, or none. Raises `sqlite3.Error`; the same call may be repeated.

        A commit can fail although its rows are durable; so a repetition first asks the file.
        """
        if entries and self._stored_last() == self._last + len(entries):
            self._last += len(entries)
            entries = ()
        if not entries and not versions:
            return
        rows = [(self._last + number, *entry, zlib.crc32(entry.raw)) for number, entry in enumerate(entries, start=1)]
        with database.transaction(self._db):
            self._db.executemany("INSERT INTO entry VALUES (?, ?, ?, ?, ?, ?, ?)", rows)
            self._db.executemany("INSERT OR REPLACE INTO version VALUES (?, ?)", versions)
            for version, _ in versions[-1:]:
                self._db.execute("DELETE FROM version WHERE version <= ?", (version - self._versions_kept,))
        self._last += len(entries)

    def entries(self) -> Iterator[tuple[int, Entry | None]]:
        """All entries in order as (id, entry); None in place of a damaged one, which is left where it is."""
        for id_, kind, camera, boot, seq, raw, crc in self._db.execute("SELECT * FROM entry ORDER BY id"):
            good = isinstance(raw, bytes) and zlib.crc32(raw) == crc
            yield id_, Entry(kind, camera, boot, seq, raw) if good else None

    def streams(self) -> dict[tuple[str, str], int]:
        """The highest stored seq of each (camera, boot)."""
        rows = self._db.execute("SELECT camera, boot, MAX(seq) FROM entry WHERE boot IS NOT NULL GROUP BY camera, boot")
        return {(camera, boot): seq for camera, boot, seq in rows}

    def versions(self) -> dict[int, str]:
        """Version -> digest of the newest versions that may have been published."""
        return dict(self._db.execute("SELECT version, digest FROM version"))

    def forget_versions(self) -> None:
        """A new epoch begins."""
        self._db.execute("DELETE FROM version")

    def __len__(self) -> int:
        return self._last

    def close(self) -> None:
        """Close and let go of the directory; may be called twice."""
        self._db.close()
        self._lock.close()

    def _stored_last(self) -> int:
        return int(self._db.execute("SELECT COALESCE(MAX(id), 0) FROM entry").fetchone()[0])
