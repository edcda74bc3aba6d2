"""The daemon's journal: what was received, in the order it was learned, the versions it led to, and
snapshots of the learner.

One SQLite database, so that no two ledgers can disagree. An entry is the bytes as received; a
snapshot and the entries after its position, in order through the learner, give the same versions
with the same digests as an uninterrupted run. An event is acknowledged only after its transaction
is committed; a version is published only after it is stored. What is older than the retention and
than both snapshots is forgotten.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import math
import sqlite3
import statistics
import threading
import zlib
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, Literal, NamedTuple

from msgspec import Struct

from camtopod.config import KeepSettings
from camtopod.serve.storage import journal_schema, sqlite_file
from camtopod.serve.storage.journal_schema import SCHEMA, last_entry, prepare, rescue
from camtopod.serve.storage.open_files import Displaced
from camtopod.serve.storage.sqlite_file import crc
from camtopod.serve.storage.witness import Witness

log = logging.getLogger(__name__)

SNAPSHOTS_KEPT = 2
"""Should the newest be damaged there is another."""
BOOTS_KEPT_MAX = 16
"""Of each camera; of the publisher's older incarnations nothing is expected any more."""
STREAMS_KEPT_MAX = 100_000
"""Of all cameras: names can be made up."""
PRUNED_ROWS_MAX = 5_000
"""At most this many entries are forgotten at a time, so that a transaction stays short."""
USUAL_STAMPS = 1_000
"""More than half of these would have to be stored while the clock is wrong, for it to be
believed.
"""
CHUNK_ENTRIES = 1_000
"""Read at a time; a read that went on for long would keep the log from being folded in."""
DAY_SECONDS = 86_400
_COMPRESSION = 3
_ROWS_AT_ONCE = (1_000, 100, 10, 1)
"""Other threads get their turn after each statement, and it may be long before this one has its
again: so few.
"""

EntryKind = Literal["event", "future", "refused", "advance", "rewind", "leave-out"]
"""``event``: learned. ``future``, ``refused``: kept for the record and for the sequence, not
learned. ``advance``: event time went on without an event; ``raw`` is the time as decimal text.
``rewind``, ``leave-out``: what had been learned is corrected, in a new epoch; see
`camtopod.serve.storage.corrections`."""


class Entry(Struct, frozen=True, gc=False):
    """One row: what happened next."""

    kind: EntryKind
    camera: str
    boot: str | None
    seq: int | None
    raw: bytes


class StoredVersion(NamedTuple):
    """A version of the topology; ``content`` as JSON, empty if only the digest is known."""

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
    """Any thread may call; one at a time is served. Raises `database.StateError` if the directory
    cannot be used, and `database.Damaged` as soon as damage shows.
    """

    def __init__(self, directory: Path, keep: KeepSettings | None = None) -> None:
        self._keep = keep or KeepSettings()
        self._mutex = threading.RLock()
        self._lock = sqlite_file.Lock(directory / "journal.lock")
        self._witness = Witness(self._lock)
        self._path = directory / "journal.db"
        self._followed: set[tuple[str, str | None]] = (
            set()
        )  # (camera, boot) that had entries since the start
        self._seen: dict[str, Any] = {}
        self._sure = True  # False after a transaction that raised an error
        self.set_aside: Path | None = None
        """Where a journal that was damaged is now; this one has begun anew."""
        self.missing = 0
        """Entries that were lost before the journal was opened, as far as that is known."""
        with contextlib.ExitStack() as undo:
            undo.callback(self._lock.close)
            self._db, self.set_aside = sqlite_file.connect_or_begin_anew(
                self._path, SCHEMA, prepare
            )
            undo.callback(self._db.close)
            try:
                with sqlite_file.damage_noticed(self._path):
                    if last_entry(self._db) == 0:
                        self._rescue()
                    self._last = last_entry(self._db)
                    self._compare()
            except sqlite3.Error as error:
                raise sqlite_file.StateError(
                    f"cannot read {self._path}: {error}; it is left as it is"
                ) from None
            undo.pop_all()
        self.status()  # so that there are numbers from the start

    def _rescue(self) -> None:
        """Into a journal that is empty; the one before it may have been set aside in an earlier
        try.
        """
        for aside in sqlite_file.damaged_files(self._path)[-1:]:
            with sqlite_file.transaction(self._db):
                rescued = rescue(self._db, aside)
            log.error("%d entries were read out of the damaged journal %s", rescued, aside)

    def _compare(self) -> None:
        """Begin a new epoch, and say so, if the journal is older than it was."""
        known, found = self._witness.known, journal_schema.how_far(self._db)
        self.missing = max(0, known.entries - found.entries)
        if found.is_older_than(known):
            log.error(
                "%s has come back older than it was: it had %d entries and has %d; the others are filled in as far as "
                "the cameras' spools still have them, and a new epoch begins",
                self._path,
                found.entries + self.missing,
                found.entries,
            )
            with sqlite_file.transaction(self._db):
                journal_schema.begin_behind(self._db, known)
        self._witness.note(journal_schema.how_far(self._db))

    def meta(self, key: str) -> str | None:
        """A value kept by `set_meta`; None also if it is damaged."""
        with self._mutex, sqlite_file.damage_noticed(self._path):
            return journal_schema.read_meta(self._db, key)

    def set_meta(self, key: str, value: str) -> None:
        """Keep a value. Raises `sqlite3.Error`."""
        with self._mutex, sqlite_file.damage_noticed(self._path):
            self._check()
            journal_schema.write_meta(self._db, key, value)
            self._check()
            self._witness.note(journal_schema.how_far(self._db))

    def commit(
        self,
        entries: Sequence[Entry],
        versions: Sequence[StoredVersion] = (),
        snapshot: Snapshot | None = None,
        now: float = 0.0,
    ) -> None:
        """Store all of it in one transaction, or none; ``now``: Unix seconds. Raises
        `sqlite3.Error`; the same call may be repeated.

        A commit can fail although its rows are durable; so a repetition first asks the file.
        Without anything to store the files are checked all the same (`Displaced`), which is cheap.
        """
        with self._mutex, sqlite_file.damage_noticed(self._path):
            self._check()
            if not entries and not versions and snapshot is None:
                return

            streams: Iterable[tuple[str, str | None]] = ()
            if not entries or not self._has(len(entries)):
                self._sure = False  # an error leaves open whether the rows are there
                with sqlite_file.transaction(self._db):
                    streams = self._add_entries(entries, int(now))
                    for version in versions:
                        self._add_version(version, int(now))
                    if snapshot is not None:
                        self._add_snapshot(snapshot, int(now))
                self._check()  # before anything counts as stored
            self._sure = True
            self._last += len(entries)

            known = self._witness.known
            newest = journal_schema.last_version(self._db) if versions else known.versions
            self._witness.note(known._replace(entries=self._last, versions=newest))
            if len(self._followed) > STREAMS_KEPT_MAX:
                self._followed.clear()
            self._followed.update(streams)

    def usual_stamp(self) -> float | None:
        """When the newest entries (or versions, if there are no entries) were stored, Unix seconds:
        the median, for a clock may have been wrong for a few. None: there are neither. Raises
        `sqlite3.Error`.
        """
        with self._mutex, sqlite_file.damage_noticed(self._path):
            for table in ("entry", "version"):
                newest = f"SELECT stored FROM {table} ORDER BY id DESC LIMIT ?"
                if rows := self._db.execute(newest, (USUAL_STAMPS,)).fetchall():
                    return float(statistics.median(stored for (stored,) in rows))
        return None

    def prune(self, now: float) -> bool:
        """Forget some of what is older than is to be kept (``now``: Unix seconds); to be called now
        and then, and again if there is more. Raises `sqlite3.Error`.
        """
        with self._mutex, sqlite_file.damage_noticed(self._path):
            self._check()
            keep, oldest = self._keep, self._oldest_snapshot()
            size, free, pages = (
                self._pragma(name) for name in ("page_size", "freelist_count", "page_count")
            )
            too_large = (pages - free) * size > keep.journal_bytes_max
            first = self._db.execute("SELECT COALESCE(MIN(id), 0) FROM entry").fetchone()[0]
            until = min(first + PRUNED_ROWS_MAX, oldest + 1)
            kept_from = math.inf if too_large else now - keep.journal_days * DAY_SECONDS
            with sqlite_file.transaction(self._db):
                gone = self._db.execute(
                    "DELETE FROM entry WHERE id < ? AND stored < ?", (until, kept_from)
                ).rowcount
                self._db.execute(
                    "DELETE FROM stream WHERE entry <= (SELECT entry FROM stream ORDER BY entry DESC LIMIT 1 OFFSET ?)",
                    (STREAMS_KEPT_MAX,),
                )
                self._db.execute(
                    "DELETE FROM version WHERE stored < ? AND id < (SELECT MAX(id) FROM version)",
                    (now - keep.history_days * DAY_SECONDS,),
                )
                while (
                    self._history_bytes() > keep.history_bytes_max and self._forget_oldest_version()
                ):
                    pass
            return gone > 0 and until <= oldest

    def entries(
        self, after: int = 0, up_to: int | None = None
    ) -> Iterator[tuple[int, Entry | None]]:
        """The entries behind ``after`` in order as (id, entry); None in place of a damaged one,
        which is left where it is, and of one that is missing. Read in chunks, so that more may be
        stored meanwhile.
        """
        last = len(self) if up_to is None else up_to
        after = max(after, self.first() - 1)  # what is older has been forgotten
        while after < last:
            with self._mutex, sqlite_file.damage_noticed(self._path):
                rows = self._db.execute(
                    "SELECT * FROM entry WHERE id > ? AND id <= ? ORDER BY id LIMIT ?",
                    (after, last, CHUNK_ENTRIES),
                ).fetchall()
            if not rows:
                return
            for row in rows:
                yield from ((missing, None) for missing in range(after + 1, row[0]))
                after = row[0]
                yield row[0], Entry(*row[2:7]) if crc(*row[:7]) == row[7] else None

    def corrections(self, after: int) -> list[tuple[int, Entry]]:
        """The corrections behind the entry ``after``, as (id, entry). Raises `sqlite3.Error`."""
        with self._mutex, sqlite_file.damage_noticed(self._path):
            rows = self._db.execute(
                "SELECT * FROM entry WHERE id > ? AND kind IN ('rewind', 'leave-out') ORDER BY id",
                (after,),
            ).fetchall()
        return [(row[0], Entry(*row[2:7])) for row in rows if crc(*row[:7]) == row[7]]

    def senders(self, after: int, up_to: int) -> dict[str, int]:
        """How many events each camera has among the entries behind ``after``. Raises
        `sqlite3.Error`.
        """
        with self._mutex, sqlite_file.damage_noticed(self._path):
            counted = "SELECT camera, COUNT(*) FROM entry WHERE id > ? AND id <= ? AND kind = 'event' GROUP BY camera"
            return dict(self._db.execute(counted, (after, up_to)).fetchall())

    def numbered(self, camera: str, boot: str, seq: int) -> Entry | None:
        """The entry with this number; None if it is not kept any more, or damaged. Raises
        `sqlite3.Error`.
        """
        with self._mutex, sqlite_file.damage_noticed(self._path):
            numbered = "SELECT * FROM entry WHERE camera = ? AND boot = ? AND seq = ?"
            row = self._db.execute(numbered, (camera, boot, seq)).fetchone()
        return Entry(*row[2:7]) if row is not None and crc(*row[:7]) == row[7] else None

    def streams(self) -> dict[tuple[str, str], int]:
        """The highest stored seq of each (camera, boot), those that stored last at the end.

        A damaged row is left out: its publisher's events come again, as far as it has them, and
        count once.
        """
        with self._mutex, sqlite_file.damage_noticed(self._path):
            rows = self._db.execute(
                "SELECT camera, boot, seq, entry, crc FROM stream ORDER BY entry"
            ).fetchall()
        damaged = sum(crc(*row[:4]) != row[4] for row in rows)
        if damaged:
            log.error(
                "%d damaged rows say how far publishers have come; they are not used", damaged
            )
        return {(row[0], row[1]): row[2] for row in rows if crc(*row[:4]) == row[4]}

    def versions(self, epoch: str) -> dict[int, str]:
        """Version -> digest of the newest versions of an epoch that may have been published."""
        with self._mutex, sqlite_file.damage_noticed(self._path):
            return dict(
                self._db.execute(
                    "SELECT version, digest FROM version WHERE epoch = ? ORDER BY version", (epoch,)
                )
            )

    def version(self, epoch: str, version: int | None = None) -> bytes | None:
        """The topology of a version, or of the newest, as JSON; None if it is not kept or
        damaged.
        """
        with self._mutex, sqlite_file.damage_noticed(self._path):
            row = self._db.execute(
                "SELECT * FROM version WHERE epoch = ? AND version = COALESCE(?, "
                "(SELECT MAX(version) FROM version WHERE epoch = ?)) AND size > 0",
                (epoch, version, epoch),
            ).fetchone()
        if row is None:
            return None
        if crc(*row[:7]) != row[7]:
            log.error(
                "version %d of the journal is damaged and left out; it is still in the file", row[2]
            )
            return None
        return zlib.decompress(row[6])

    def newest_version(self) -> bytes | None:
        """The topology stored last, of whatever epoch, as JSON; None if there is none."""
        with self._mutex, sqlite_file.damage_noticed(self._path):
            row = self._db.execute(
                "SELECT epoch, version FROM version WHERE size > 0 ORDER BY id DESC"
            ).fetchone()
        return None if row is None else self.version(*row)

    def snapshots(self) -> list[Snapshot]:
        """Newest first; damaged ones are left out and reported."""
        with self._mutex, sqlite_file.damage_noticed(self._path):
            rows = self._db.execute("SELECT * FROM snapshot ORDER BY position DESC").fetchall()
        for row in rows:
            if crc(*row[:4]) != row[4]:
                log.error(
                    "the snapshot at entry %d is damaged and not used; it is still in the file",
                    row[0],
                )
        return [Snapshot(row[0], row[1], row[3]) for row in rows if crc(*row[:4]) == row[4]]

    def first(self) -> int:
        """The oldest entry that is kept; 0 if there is none."""
        with self._mutex, sqlite_file.damage_noticed(self._path):
            return int(self._db.execute("SELECT COALESCE(MIN(id), 0) FROM entry").fetchone()[0])

    def __len__(self) -> int:
        """The number of the newest entry: how many there have ever been."""
        return self._last

    def size(self) -> int:
        """Bytes in use in the database."""
        with self._mutex, sqlite_file.damage_noticed(self._path):
            return self._pragma("page_size") * (
                self._pragma("page_count") - self._pragma("freelist_count")
            )

    def status(self) -> dict[str, Any]:
        """Entries, bytes and damaged files; of a disk that cannot be read the reason. Does not wait
        for a transaction under way, which a disk can hold up for long: the numbers are then those
        of before.
        """
        if self._mutex.acquire(blocking=False):
            try:
                files = [path.name for path in self.damaged_files()]
                self._seen = {"bytes": self.size(), "damaged_files": files}
            except (sqlite3.Error, OSError) as error:
                self._seen = {"reason": str(error)}
            finally:
                self._mutex.release()
        return {"entries": len(self), "missing": self.missing, **self._seen}

    def damaged_files(self) -> list[Path]:
        """What was set aside of the database and its log and is still there, for somebody to look
        at.
        """
        return [*sqlite_file.damaged_files(self._path), *self.damaged_logs()]

    def damaged_logs(self) -> list[Path]:
        """Of its log alone, the newest last: transactions that had been committed are not in the
        database.
        """
        return sqlite_file.damaged_files(self._path.with_name(f"{self._path.name}-wal"))

    def close(self) -> None:
        """Close and let go of the directory; may be called twice."""
        with self._mutex, sqlite_file.damage_noticed(self._path):
            self._db.close()
            self._lock.close()

    def _check(self) -> None:
        """Raise `Displaced` if a file in use is not in place."""
        self._db.check()
        self._lock.check()

    def _has(self, count: int) -> bool:
        """Return True if the ``count`` entries to be stored are durable already, with their whole
        transaction, which raised an error. Raises `Displaced` if the journal has entries of another
        program.
        """
        last = last_entry(self._db)
        if last == self._last + count and not self._sure:
            return True
        if last != self._last:
            raise Displaced(
                f"{self._path} was changed by another program, its last entry is {last} and was {self._last}: "
                f"stop that program, and restart this one"
            )
        return False

    def _add_entries(
        self, entries: Sequence[Entry], stored: int
    ) -> Iterable[tuple[str, str | None]]:
        """Returns the streams they belong to."""
        rows = [
            (number, stored, one.kind, one.camera, one.boot, one.seq, one.raw)
            for number, one in enumerate(entries, start=self._last + 1)
        ]
        self._insert("INSERT INTO entry", rows)
        newest = {
            (row[3], row[4]): (row[3], row[4], row[5], row[0]) for row in rows if row[4] is not None
        }
        self._insert("INSERT OR REPLACE INTO stream", [*newest.values()])
        for camera in {
            camera for camera, _ in newest.keys() - self._followed
        }:  # which now have another boot
            self._db.execute(
                "DELETE FROM stream WHERE camera = ? AND boot NOT IN "
                "(SELECT boot FROM stream WHERE camera = ? ORDER BY entry DESC LIMIT ?)",
                (camera, camera, BOOTS_KEPT_MAX),
            )
        return newest.keys()

    def _insert(self, insert: str, rows: Sequence[tuple[Any, ...]]) -> None:
        """Rows of equal length, each with its checksum."""
        start, variables_max = 0, self._db.getlimit(sqlite3.SQLITE_LIMIT_VARIABLE_NUMBER)
        for size in _ROWS_AT_ONCE:
            while len(rows) - start >= size and size * (len(rows[0]) + 1) <= variables_max:
                some = [(*row, crc(*row)) for row in rows[start : start + size]]
                self._db.execute(
                    _values(insert, len(rows[0]) + 1, size), [*chain.from_iterable(some)]
                )
                start += size

    def _insert_large(self, insert: str, row: tuple[Any, ...]) -> None:
        """One row, with its checksum. Its statement is kept for the next, and with it a copy of
        what it was given last: that is nothing.
        """
        for values in ((*row, crc(*row)), (None,) * (len(row) + 1)):
            self._db.execute(
                f"{insert} SELECT {', '.join('?' * len(values))} WHERE ?1 IS NOT NULL", values
            )

    def _add_version(self, version: StoredVersion, stored: int) -> None:
        number = journal_schema.last_version(self._db) + 1
        content = zlib.compress(version.content, _COMPRESSION) if version.content else b""
        row = (
            number,
            version.epoch,
            version.version,
            stored,
            version.digest,
            len(content),
            content,
        )
        self._insert_large("INSERT OR IGNORE INTO version", row)

    def _add_snapshot(self, snapshot: Snapshot, stored: int) -> None:
        row = (snapshot.position, snapshot.epoch, stored, snapshot.state)
        self._insert_large("INSERT OR REPLACE INTO snapshot", row)
        self._db.execute(
            "DELETE FROM snapshot WHERE position NOT IN (SELECT position FROM snapshot ORDER BY position DESC LIMIT ?)",
            (SNAPSHOTS_KEPT,),
        )

    def _oldest_snapshot(self) -> int:
        """Position of the older of two snapshots; 0 with fewer, as then all entries are needed."""
        found = self._db.execute("SELECT position FROM snapshot ORDER BY position DESC").fetchall()
        return int(found[SNAPSHOTS_KEPT - 1][0]) if len(found) >= SNAPSHOTS_KEPT else 0

    def _history_bytes(self) -> int:
        return int(self._db.execute("SELECT COALESCE(SUM(size), 0) FROM version").fetchone()[0])

    def _forget_oldest_version(self) -> bool:
        """False if there is only the newest left."""
        return bool(
            self._db.execute(
                "DELETE FROM version WHERE id = (SELECT MIN(id) FROM version) AND id < (SELECT MAX(id) FROM version)"
            ).rowcount
        )

    def _pragma(self, name: str) -> int:
        return int(self._db.execute(f"PRAGMA {name}").fetchone()[0])


@functools.cache
def _values(insert: str, columns: int, rows: int) -> str:
    """The statement that inserts so many rows of so many columns."""
    row = f"({', '.join('?' * columns)})"
    return f"{insert} VALUES {', '.join([row] * rows)}"
