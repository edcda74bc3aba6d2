"""The publisher's spool: every event is here, durably, from before it is put until it is acknowledged.

What a put says is not believed; the daemon asks the spool for what it has not got. A spool has a ``boot`` of
its own and counts each camera's events within it; an event that brings its own boot and seq keeps them.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from camtopod import codec
from camtopod.records import CameraId, Event
from camtopod.serve import database

_SCHEMA = """
CREATE TABLE IF NOT EXISTS meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS count (camera TEXT PRIMARY KEY, seq INTEGER NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS event (
    id INTEGER PRIMARY KEY AUTOINCREMENT, camera TEXT NOT NULL, boot TEXT NOT NULL, seq INTEGER NOT NULL,
    raw BLOB NOT NULL);
CREATE UNIQUE INDEX IF NOT EXISTS event_stream ON event (camera, boot, seq);
"""
_INSERT = "INSERT OR IGNORE INTO event (camera, boot, seq, raw) VALUES (?, ?, ?, ?)"

Seq = Annotated[int, Meta(ge=0, le=2**63 - 1)]


class SpoolBatch(Struct, frozen=True):
    """Events of one (camera, boot) that are not acknowledged, by rising seq; each as the bytes that were put.

    ``first`` is the lowest seq of this boot that the spool still has or will give next: what is below it was
    acknowledged, or dropped because the spool was full (``dropped`` counts those, all cameras together).
    ``more``: this boot has further ones.
    """

    camera: CameraId
    boot: Annotated[str, Meta(max_length=64)]
    first: Seq
    dropped: int
    more: bool
    events: list[tuple[Seq, bytes]]


class Spool:
    """A spool file, for one publishing process. Thread-safe. Raises `database.StateError` on opening."""

    def __init__(self, path: Path, boot: str, events_max: int) -> None:
        self._mutex = threading.Lock()
        self._events_max = events_max
        self._acked: dict[tuple[str, str], int] = {}
        self._lock = database.Lock(path.with_suffix(".lock"))
        try:
            self._db = database.connect(path, _SCHEMA)
        except database.StateError:
            self._lock.close()
            raise
        self._db.execute("INSERT OR IGNORE INTO meta VALUES ('boot', ?)", (boot,))
        self.boot = str(self._db.execute("SELECT value FROM meta WHERE key = 'boot'").fetchone()[0])
        """This spool's incarnation: the one given when its file was made."""
        self._seqs = dict(self._db.execute("SELECT camera, seq FROM count"))
        self._held = self._count()
        self._sure = True
        self.dropped = 0
        """Events dropped because the spool was full, since it was opened."""

    def append(self, events: Sequence[Event]) -> list[Event]:
        """Store in one transaction; returns the events with boot and seq. Raises `sqlite3.Error`.

        An event that is in the spool already (same camera, boot and seq) is stored once.
        """
        with self._mutex:
            seqs = dict(self._seqs)
            numbered = []
            for event in events:
                if event.boot is None or event.seq is None:
                    seq = seqs[event.camera] = seqs.get(event.camera, 0) + 1
                    event = msgspec.structs.replace(event, boot=self.boot, seq=seq)
                numbered.append(event)
            rows = [(event.camera, event.boot, event.seq, codec.to_pack(event)) for event in numbered]
            self._sure, sure = False, self._sure  # should this raise, its rows may be there or not
            with database.transaction(self._db):
                stored = self._db.executemany(_INSERT, rows).rowcount
                self._db.executemany(
                    "INSERT OR REPLACE INTO count VALUES (?, ?)",
                    [(event.camera, seqs[event.camera]) for event in numbered if event.camera in seqs],
                )
            self._seqs = seqs
            self._held = self._held + stored if sure else self._count()
            self._sure = True
            self._drop_oldest()
            return numbered

    def ack(self, camera: str, boot: str, seq: int) -> None:
        """Everything of (camera, boot) up to ``seq`` is safe elsewhere: forget it."""
        with self._mutex:
            if seq <= self._acked.get((camera, boot), -1):
                return
            gone = self._db.execute(
                "DELETE FROM event WHERE camera = ? AND boot = ? AND seq <= ?", (camera, boot, seq)
            ).rowcount
            self._held -= gone
            if gone or boot == self.boot:
                self._acked[camera, boot] = seq

    def batch(self, camera: str, boot: str | None, from_seq: int, events_max: int) -> SpoolBatch:
        """Events of ``camera`` from ``from_seq`` of ``boot`` on; if there are none, of the oldest other."""
        with self._mutex:
            chosen, start = boot, from_seq
            if boot is None or not self._has(camera, boot, from_seq):
                row = self._db.execute(
                    "SELECT boot FROM event WHERE camera = ? AND boot IS NOT ? ORDER BY id LIMIT 1",
                    (camera, boot),
                ).fetchone()
                chosen, start = (row[0], -1) if row else (boot or self.boot, from_seq)
            rows = self._db.execute(
                "SELECT seq, raw FROM event WHERE camera = ? AND boot = ? AND seq >= ? ORDER BY seq LIMIT ?",
                (camera, chosen, start, events_max + 1),
            ).fetchall()
            assert chosen is not None
            return SpoolBatch(
                camera=camera,
                boot=chosen,
                first=self._first(camera, chosen),
                dropped=self.dropped,
                more=len(rows) > events_max,
                events=rows[:events_max],
            )

    def cameras(self) -> list[str]:
        """The cameras with events that are not acknowledged."""
        with self._mutex:
            return [row[0] for row in self._db.execute("SELECT DISTINCT camera FROM event")]

    def __len__(self) -> int:
        """Events not acknowledged."""
        with self._mutex:
            return self._held

    def close(self) -> None:
        """Close the file; what is in it stays for the next time."""
        with self._mutex:
            self._db.close()
            self._lock.close()

    def _count(self) -> int:
        return int(self._db.execute("SELECT COUNT(*) FROM event").fetchone()[0])

    def _has(self, camera: str, boot: str, from_seq: int) -> bool:
        row = self._db.execute(
            "SELECT 1 FROM event WHERE camera = ? AND boot = ? AND seq >= ? LIMIT 1", (camera, boot, from_seq)
        ).fetchone()
        return row is not None

    def _first(self, camera: str, boot: str) -> int:
        row = self._db.execute("SELECT MIN(seq) FROM event WHERE camera = ? AND boot = ?", (camera, boot)).fetchone()
        if row[0] is not None:
            return int(row[0])
        known = self._acked.get((camera, boot), -1)
        return 1 + (max(known, self._seqs.get(camera, 0)) if boot == self.boot else known)

    def _drop_oldest(self) -> None:
        surplus = self._held - self._events_max
        if surplus > 0:
            self._db.execute("DELETE FROM event WHERE id IN (SELECT id FROM event ORDER BY id LIMIT ?)", (surplus,))
            self._held -= surplus
            self.dropped += surplus
