"""The daemon's journal: received events in the order of learning, versions and snapshots.

It is one SQLite database, so that its parts cannot disagree. An entry holds the bytes as received;
a snapshot and the entries after its position, in order through the learner, give the same versions
with the same digests as an uninterrupted run. An event is acknowledged only after its transaction
is committed; a version is published only after it is stored. Entries before both snapshots are
deleted when they exceed the retention.
"""

from __future__ import annotations

import contextlib
import logging
import math
import sqlite3
import threading
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from msgspec import Struct

from camtopod.config import KeepSettings
from camtopod.records import JournalStatus
from camtopod.serve.storage import journal_schema, sqlite_file
from camtopod.serve.storage.journal_schema import (
    FORMAT,
    SCHEMA,
    insert,
    insert_large,
    last_entry,
    rescue,
)
from camtopod.serve.storage.sqlite_file import sound
from camtopod.serve.storage.witness import Witness

log = logging.getLogger(__name__)

SNAPSHOTS_KEPT = 2
"""Snapshots kept, the newest ones; the second is for the case that the newest is damaged."""
STREAMS_KEPT_MAX = 100_000
"""Most (camera, boot) whose stored seq is kept, over all cameras, as anyone can invent names."""
PRUNED_ROWS_MAX = 5_000
"""Most entries deleted at a time, so that a transaction stays short."""
HISTORY_BYTES_MAX = 256 << 20
"""Maximum size of the old versions, compressed; beyond it the oldest are deleted."""
CHUNK_ENTRIES = 1_000
"""Entries read at a time; a long read would keep SQLite from checkpointing the log."""
VERSIONS_TRIED_MAX = 10
"""Newest versions of which the first undamaged one is used at a start."""
EntryKind = Literal[
    "event", "future", "refused", "advance", "waits", "command", "correction", "skipped"
]
"""Kinds of entries.

``event``: learned. ``future``, ``refused``: kept for the record and for the sequence, not learned.
``advance``: event time advanced without an event; ``raw`` is the time as decimal text.
``waits``: cameras that the learner waits for from here on; ``raw`` is the list in JSON.
``command``: an operator's command. ``correction``: one that begins an epoch. ``skipped``: the
learner died of it twice.
"""


_COMMANDS = "('command', 'correction')"
"""Kinds of entries that are kept for ever, as the names follow from them (in SQL)."""

Stream = tuple[str, str]
"""(camera, boot)."""


class Entry(Struct, frozen=True, gc=False):
    """One row of the journal: the event as received in ``raw``, its number in ``boot``, ``seq``.

    An event that came under the old name of a renamed camera has the new name in ``raw``.
    """

    kind: EntryKind
    camera: str
    boot: str | None
    seq: int | None
    raw: bytes


class StoredVersion(NamedTuple):
    """A version of the topology; ``content`` is JSON."""

    epoch: str
    version: int
    digest: str
    content: bytes


class Snapshot(NamedTuple):
    """The learner's packed state after the entry ``position``."""

    position: int
    epoch: str
    state: bytes


class Journal:
    """The journal in a state directory. Thread-safe; one call at a time is served.

    Raises `sqlite_file.StateError` if the directory cannot be used, and `sqlite_file.Damaged` as
    soon as damage shows.
    """

    def __init__(self, directory: Path, keep: KeepSettings | None = None) -> None:
        self._keep = keep or KeepSettings()
        self._mutex = threading.RLock()
        self._lock = sqlite_file.Lock(directory / "journal.lock")
        self._witness = Witness(self._lock)
        self._path = directory / "journal.db"
        self.missing = 0
        """Number of entries known to have been lost before the journal was opened."""

        # Open the file; release everything after an error.
        with contextlib.ExitStack() as undo:
            undo.callback(self._lock.close)
            self._db, self.set_aside = sqlite_file.connect_or_recreate(self._path, SCHEMA, FORMAT)
            """Path of a damaged journal that was set aside on opening; this one began empty."""
            undo.callback(self._db.close)
            try:
                with self._access():
                    if last_entry(self._db) == 0:
                        self._rescue()
                    self._last = last_entry(self._db)
                    self._compare()
            except sqlite3.Error as error:
                raise sqlite_file.StateError(
                    f"cannot read {self._path}: {error}; the file was not modified"
                ) from None
            undo.pop_all()

    @contextlib.contextmanager
    def _access(self) -> Iterator[None]:
        """Serve one call: others wait, and damage is noticed."""
        with self._mutex, sqlite_file.damage_noticed(self._path):
            yield

    def _rescue(self) -> None:
        """Read entries out of the newest damaged journal into this one, which is empty.

        The damaged journal may have been set aside in an earlier attempt.
        """
        for aside in sqlite_file.damaged_files(self._path)[-1:]:
            with sqlite_file.transaction(self._db):
                count = rescue(self._db, aside)
            log.error("%d entries were read out of the damaged journal %s", count, aside)

    def _compare(self) -> None:
        """Log an error and begin a new epoch if the journal is an older copy of itself."""
        record = self._witness.extent
        extent = journal_schema.how_far(self._db)
        self.missing = max(0, record.entries - extent.entries)
        if (
            extent.entries < record.entries
            or extent.versions < record.versions
            or extent.epoch < record.epoch
        ):
            log.error(
                "%s has come back older than it was: it had %d entries and has %d; the others are "
                "filled in as far as the cameras' spools still have them, and a new epoch begins",
                self._path,
                extent.entries + self.missing,
                extent.entries,
            )
            with sqlite_file.transaction(self._db):
                # Published versions may be missing; the next epoch sorts after all that are known.
                self._db.execute("DELETE FROM meta WHERE key = 'epoch'")
                newest = max(extent.epoch, record.epoch)
                journal_schema.write_meta(self._db, "epoch before", newest)
        self._witness.note(journal_schema.how_far(self._db))

    def meta(self, key: str) -> str | None:
        """Return a value stored by `set_meta`; None if there is none or it is damaged."""
        with self._access():
            return journal_schema.read_meta(self._db, key)

    def set_meta(self, key: str, value: str) -> None:
        """Store a value under ``key``. Raises `sqlite3.Error`."""
        with self._access():
            self._db.check()
            journal_schema.write_meta(self._db, key, value)
            self._witness.note(journal_schema.how_far(self._db))

    def commit(
        self,
        entries: Sequence[Entry],
        versions: Sequence[StoredVersion] = (),
        snapshot: Snapshot | None = None,
        now: float = 0.0,
        meta: Mapping[str, str] | None = None,
    ) -> Sequence[Entry]:
        """Store everything in one transaction, or nothing.

        entries: appended in this order.
        now (Unix seconds): when they are stored.
        meta: values to store under their keys, as `set_meta` does.

        Returns the entries that were not there before, which are nearly always all: after a rescue
        entries may be stored behind a hole that the spools fill now, and the entries of a boot
        outlast its number. Raises `sqlite3.Error`; then the same call may be repeated. Without
        anything to store, only `Displaced` is raised if the file is not in place.
        """
        with self._access():
            self._db.check()
            if not (entries or versions or snapshot or meta):
                return entries

            # Write; where some are there already, the others.
            highest = highest_numbers(entries)

            def write(new: Sequence[Entry]) -> Sequence[Entry]:
                with sqlite_file.transaction(self._db):
                    last = self._add_entries(new, highest, int(now))
                    for version in versions:
                        self._add_version(version, int(now))
                    if snapshot is not None:
                        self._add_snapshot(snapshot, int(now))
                    for key, value in (meta or {}).items():
                        journal_schema.write_meta(self._db, key, value)
                    self._db.check()  # again, as a transaction can take long
                self._last = last
                return new

            try:
                new = write(entries)
            except sqlite3.IntegrityError:
                new = write([entry for entry in entries if not self._has(entry)])

            self._witness.note(journal_schema.how_far(self._db))
            return new

    def prune(self, now: float) -> bool:
        """Delete entries, streams and versions beyond the retention; return True if more are left.

        now (Unix seconds): the time from which ages are counted.

        A part is deleted at a time: call it now and then, and again if it returns True. Raises
        `sqlite3.Error`.
        """
        with self._access():
            # Find the entries to delete: those before both snapshots that are too old, or all of
            # those if the journal is too large.
            keep = self._keep
            positions = self._db.execute("SELECT position FROM snapshot ORDER BY 1").fetchall()
            oldest = positions[0][0] if len(positions) >= SNAPSHOTS_KEPT else 0
            too_large = sqlite_file.used_bytes(self._db) > keep.journal_bytes_max
            until = min(self.first() + PRUNED_ROWS_MAX, oldest + 1)
            kept_from = math.inf if too_large else now - keep.journal_days * 86_400

            # Delete entries, streams and versions.
            with sqlite_file.transaction(self._db):
                count = self._db.execute(
                    f"DELETE FROM entry WHERE id < ? AND stored < ? AND kind NOT IN {_COMMANDS}",
                    (until, kept_from),
                ).rowcount
                self._db.execute(
                    "DELETE FROM stream WHERE entry <="
                    " (SELECT entry FROM stream ORDER BY entry DESC LIMIT 1 OFFSET ?)",
                    (STREAMS_KEPT_MAX,),
                )
                self._db.execute(
                    "DELETE FROM version WHERE id < (SELECT MAX(id) FROM version) AND (stored < ?"
                    " OR id IN (SELECT id FROM (SELECT id, SUM(size) OVER (ORDER BY id DESC)"
                    " AS held FROM version) WHERE held > ?))",
                    (now - keep.history_days * 86_400, HISTORY_BYTES_MAX),
                )
            return count > 0 and until <= oldest

    def forget(self, cameras: Mapping[str, int]) -> bool:
        """Delete some of what is kept of forgotten cameras; return True if more is left.

        As `prune`, it is called again and again. ``cameras``: the last entry to delete of each.
        """
        with self._access(), sqlite_file.transaction(self._db):
            return journal_schema.forget(self._db, cameras)

    def entries(self, after: int = 0) -> Iterator[tuple[int, Entry | None]]:
        """Yield the entries after ``after`` in order as (id, entry).

        The entry is None if it is damaged (it then stays in the file) or missing. They are read in
        chunks, so that more can be stored meanwhile.
        """
        last = len(self)
        after = max(after, self.first() - 1)  # older entries were deleted
        while after < last:
            with self._access():
                rows = self._db.execute(
                    "SELECT * FROM entry WHERE id > ? AND id <= ? ORDER BY id LIMIT ?",
                    (after, last, CHUNK_ENTRIES),
                ).fetchall()
            if not rows:
                return
            for row in rows:
                yield from ((number, None) for number in range(after + 1, row[0]))
                after = row[0]
                yield row[0], Entry(*row[2:7]) if sound(row) else None

    def commands(self, after: int = 0, kinds: str = _COMMANDS) -> list[tuple[int, float, Entry]]:
        """Return commands and corrections after an entry: number, when it was stored, entry.

        kinds: other kinds, in SQL. Raises `sqlite3.Error`.
        """
        rows = self._rows(f"entry WHERE id > ? AND kind IN {kinds} ORDER BY id", after)
        return [(*row[:2], Entry(*row[2:7])) for row in rows]

    def skip(self, number: int) -> None:
        """Mark an entry as skipped; delete the states that have it. Raises `sqlite3.Error`."""
        with self._access():
            for row in self._db.execute("SELECT * FROM entry WHERE id = ?", (number,)).fetchall():
                insert(self._db, "INSERT OR REPLACE INTO entry", [(*row[:2], "skipped", *row[3:7])])
            self._db.execute("DELETE FROM snapshot WHERE position >= ?", (number,))

    def numbers(self) -> dict[Stream, int]:
        """Return the highest stored number of each stream, in the order of their last entries.

        A damaged number is that of the newest undamaged entry. A stream without one is left out:
        its entries were deleted long ago, so they are too late to be learned if they come again.
        """
        numbers: dict[Stream, int] = {}
        with self._access():
            for row in self._db.execute("SELECT * FROM stream ORDER BY entry").fetchall():
                stream = row[:2]
                if sound(row):
                    numbers[stream] = row[2]
                    continue
                log.error("a number of camera %s in the journal is damaged", row[0])
                entry = "entry WHERE camera = ? AND boot = ? ORDER BY seq DESC"
                if entries := self._rows(entry, *stream):
                    numbers[stream] = entries[0][5]
        return numbers

    def versions(self, epoch: str) -> dict[int, str]:
        """Return version -> digest for the versions of an epoch, which may have been published."""
        return {row[2]: row[4] for row in self._rows("version WHERE epoch = ?", epoch)}

    def version(self, epoch: str, version: int) -> bytes | None:
        """Return a version as JSON; None if it is not kept or damaged."""
        rows = self._rows("version WHERE epoch = ? AND version = ?", epoch, version)
        return zlib.decompress(rows[0][6]) if rows else None

    def newest_version(self) -> bytes | None:
        """Return the undamaged version that was stored last, of any epoch, as JSON; else None."""
        with self._access():
            rows = self._db.execute(
                "SELECT epoch, version FROM version ORDER BY id DESC LIMIT ?", (VERSIONS_TRIED_MAX,)
            ).fetchall()
        return next(filter(None, (self.version(*row) for row in rows)), None)

    def snapshots(self) -> list[Snapshot]:
        """Return the snapshots, the newest first. Damaged ones are logged and left out."""
        rows = self._rows("snapshot ORDER BY position DESC")
        return [Snapshot(row[0], row[1], row[3]) for row in rows]

    def first(self) -> int:
        """Return the number of the oldest entry that is kept, but for commands; 0 if there is none.

        Commands are kept for ever.
        """
        with self._access():
            oldest = f"SELECT MIN(id) FROM entry WHERE kind NOT IN {_COMMANDS}"
            return int(self._db.execute(oldest).fetchone()[0] or 0)

    def __len__(self) -> int:
        """Return the number of the newest entry, which is how many there have ever been."""
        return self._last

    def status(self) -> JournalStatus:
        """Return the number of entries, bytes and damaged files. Never waits for a transaction."""
        size = 0
        with contextlib.suppress(OSError):
            size = self._path.stat().st_size
        files = [path.name for path in sqlite_file.damaged_files(self._path)]
        return JournalStatus(len(self), self.missing, bytes=size, damaged_files=files)

    def close(self) -> None:
        """Close the journal and release the directory; may be called twice."""
        with self._access():
            self._db.close()
            self._lock.close()

    def _rows(self, selection: str, *values: object) -> list[tuple[Any, ...]]:
        """Return the undamaged rows of a table; ``selection``: what follows FROM.

        Damaged rows are logged and left out; they stay in the file. Raises `sqlite3.Error`.
        """
        with self._access():
            rows = self._db.execute(f"SELECT * FROM {selection}", values).fetchall()
        for row in rows:
            if not sound(row):
                log.error(
                    "a row of the journal's %s is damaged, and left out", selection.split()[0]
                )
        return list(filter(sound, rows))

    def _has(self, entry: Entry) -> bool:
        """Return True if an entry with this number (boot, seq) is stored."""
        return bool(
            self._db.execute(
                "SELECT 1 FROM entry WHERE camera = ? AND boot = ? AND seq = ?",
                (entry.camera, entry.boot, entry.seq),
            ).fetchone()
        )

    def _add_entries(self, entries: Sequence[Entry], highest: Mapping[Stream, int], t: int) -> int:
        """Insert entries, and the highest number of streams; return the number of the last entry.

        t: Unix seconds.
        """
        first = last_entry(self._db) + 1
        rows = [
            (number, t, entry.kind, entry.camera, entry.boot, entry.seq, entry.raw)
            for number, entry in enumerate(entries, start=first)
        ]
        last = first + len(rows) - 1
        insert(self._db, "INSERT INTO entry", rows)
        streams = [(*stream, seq, last) for stream, seq in highest.items()]
        insert(self._db, "INSERT OR REPLACE INTO stream", streams)
        return last

    def _add_version(self, version: StoredVersion, t: int) -> None:
        """Insert a version; ``t``: Unix seconds."""
        number = journal_schema.last_version(self._db) + 1
        content = zlib.compress(version.content, level=3)
        key = (number, version.epoch, version.version)
        row = (*key, t, version.digest, len(content), content)
        insert_large(self._db, "INSERT OR IGNORE INTO version", row)

    def _add_snapshot(self, snapshot: Snapshot, t: int) -> None:
        """Insert a snapshot, and delete those before the newest `SNAPSHOTS_KEPT`."""
        row = (snapshot.position, snapshot.epoch, t, snapshot.state)
        insert_large(self._db, "INSERT OR REPLACE INTO snapshot", row)
        self._db.execute(
            "DELETE FROM snapshot WHERE position NOT IN"
            " (SELECT position FROM snapshot ORDER BY position DESC LIMIT ?)",
            (SNAPSHOTS_KEPT,),
        )


def highest_numbers(entries: Iterable[Entry]) -> dict[Stream, int]:
    """Return the highest number of each stream among entries."""
    highest: dict[Stream, int] = {}
    for entry in entries:
        if entry.boot is not None and entry.seq is not None:
            stream = (entry.camera, entry.boot)
            highest[stream] = max(entry.seq, highest.get(stream, 0))
    return highest
