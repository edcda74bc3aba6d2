"""A publisher's spool: each event is stored here before it is published, until it is acknowledged.

Publishing an event does not show whether the daemon has received it; so the daemon queries the
spool for events it has missed. Each time a spool is opened a new ``boot`` begins, and each camera's
events are counted within it, so that a file restored from an older copy never gives the same number
to a second event. An event that brings its own boot and seq keeps them.

A spool belongs to one site. The newest acknowledged events are kept for a while, for the daemon
that acknowledged them, and each answer contains the highest acknowledged seq. So a daemon whose
journal was set back notices, and gets the events again.
"""

from __future__ import annotations

import contextlib
import logging
import sqlite3
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from camtopod import codec
from camtopod.config import Limits
from camtopod.records import CameraId, Event
from camtopod.serve.outbox import spool_schema
from camtopod.serve.runtime import clock
from camtopod.serve.storage import sqlite_file

log = logging.getLogger(__name__)

_DEFAULT = Limits()
_DELETED_MAX = 5_000
"""Most events deleted at a time, as the log grows with the transaction; a full spool adds fewer."""
_INSERT = "INSERT OR IGNORE INTO event (camera, boot, seq, raw, crc) VALUES (?, ?, ?, ?, ?)"

PROMISED = ("promised to", "promised at")
"""Keys of the table ``meta``: name and endpoint of the daemon that last acknowledged or asked."""

Seq = Annotated[int, Meta(ge=0, le=2**63 - 1)]
"""A sequence number."""
Stream = tuple[str, str]
"""(camera, boot)."""


class SpoolBatch(Struct, frozen=True):
    """Events of one (camera, boot) by rising seq, each as the bytes that were published.

    first: the lowest seq of this boot that the spool has or will give next. Those below it were
        acknowledged, or dropped because the spool was full.
    dropped: number of events that were dropped, of all cameras together.
    more: True if this boot has further events.
    acked: the highest seq of this boot that a daemon has acknowledged; a daemon whose journal has
        less has lost it. None: nothing yet, or the grabber does not tell.
    """

    camera: CameraId
    boot: Annotated[str, Meta(max_length=64)]
    first: Seq
    dropped: int
    more: bool
    events: list[tuple[Seq, bytes]]
    acked: Seq | None = None


class Spool:
    """A spool file, for one publishing process. Thread-safe.

    boot: the name of the boot that begins.
    events_max: most events.
    bytes_max: largest size of the file, in bytes.
    kept_events_max: most of the events that are acknowledged.

    A damaged file is set aside, and its readable events are copied to the new one. Raises
    `sqlite_file.StateError` on opening, and `sqlite_file.Damaged` as soon as damage shows.
    """

    def __init__(
        self,
        path: Path,
        boot: str,
        events_max: int,
        bytes_max: int = _DEFAULT.spool_bytes_max,
        kept_events_max: int = _DEFAULT.spool_kept_events,
    ) -> None:
        self._mutex = threading.Lock()
        self.path = path
        """Path of the file."""
        self._events_max, self._bytes_max, self._kept_max = events_max, bytes_max, kept_events_max
        self._lock = sqlite_file.Lock(path.with_suffix(".lock"))

        # Open the file; release everything after an error.
        with contextlib.ExitStack() as undo:
            undo.callback(self._lock.close)
            try:
                with sqlite_file.damage_noticed(path):
                    self._db, rescued = spool_schema.open_file(path)
                    undo.callback(self._db.close)
                    self._acked = spool_schema.acked(self._db)
                    self._promised = tuple(spool_schema.meta(self._db, key) for key in PROMISED)
                    self._recount()
            except sqlite3.Error as error:
                raise sqlite_file.StateError(
                    f"cannot read {path}: {error}; it is left as it is"
                ) from None
            undo.pop_all()

        # Begin a boot.
        self.boot = self._first_boot = boot
        """Name of the current boot."""
        self.rescued = rescued
        """Number of events read out of a damaged file on opening."""
        self._seqs: dict[str, int] = {}
        self._boot_written = False
        self._boots_begun = 0
        self._unwritten: set[Stream] = set()
        self._damaged: set[int] = set()
        self._sure = True
        self._said_full = False
        self._asked_last = False

    def append(self, events: Sequence[Event]) -> list[Event]:
        """Store events in one transaction; return them with boot and seq. Raises `sqlite3.Error`.

        An event that is in the spool already (same camera, boot and seq) is stored once. After an
        error the same call may be repeated: it looks in the file whether the events are stored
        after all.
        """
        with self._mutex, sqlite_file.damage_noticed(self.path):
            if not self._sure:
                self._ask_the_file(self._number(events)[0])

            # Store the events, and delete others if there are too many.
            numbered, seqs = self._number(events)
            self._sure = False  # after an error the rows may be there or not
            with sqlite_file.transaction(self._db):
                self._write_down()
                added = self._db.executemany(_INSERT, [_row(event) for event in numbered]).rowcount
                for camera in seqs.keys() & {event.camera for event in numbered}:
                    spool_schema.set_row(self._db, "count", camera, seqs[camera])
                forgotten, dropped = self._make_room(self._held + added)

            # Update the counts.
            self._seqs, self._sure = seqs, True
            self._held += added - forgotten - dropped
            self._kept -= forgotten
            self.dropped += dropped
            if dropped and not self._said_full:
                self._said_full = True
                log.error(
                    "the spool %s is full: its oldest events are dropped, %d so far",
                    self.path,
                    self.dropped,
                )
            self._boot_written = True
            self._unwritten.clear()
            if forgotten:
                self._acked = spool_schema.acked(self._db)
            return numbered

    def note_daemon(self, daemon: str, endpoint: str) -> None:
        """Note that a daemon, reached at ``endpoint``, queries or acknowledges events.

        The acknowledged events are kept for the daemon that has acknowledged them, or its successor
        at the same endpoint. They are deleted when another daemon at another endpoint comes: it
        would take them for its own. Raises `sqlite3.Error`.
        """
        with self._mutex, sqlite_file.damage_noticed(self.path):
            if self._promised == (daemon, endpoint):
                return
            same = (daemon and daemon == self._promised[0]) or endpoint == self._promised[1]
            with sqlite_file.transaction(self._db):
                self._write_down()
                forgotten = 0 if same else self._forget(self._kept)
                for key, value in zip(PROMISED, (daemon, endpoint), strict=True):
                    spool_schema.set_row(self._db, "meta", key, value)
            self._boot_written = True
            self._unwritten.clear()
            self._promised = daemon, endpoint
            self._kept -= forgotten
            self._held -= forgotten
            self._acked = spool_schema.acked(self._db)

    def ack(self, camera: str, boot: str, seq: int) -> bool:
        """Record that the events of (camera, boot) up to ``seq`` are stored by a daemon.

        Returns False if ``seq`` is above the highest one of the current boot: then another program
        has used this boot, as happens when a machine is restored to an earlier moment. Nothing is
        acknowledged then, and a new boot begins.

        For the current boot this is written with the next events, or on closing. If it is lost
        before, the daemon is sent these events once more, and acknowledges them again. For an older
        boot it is written at once: a daemon recognises only the newest boots of a camera, and there
        may be many after a time without a daemon.

        Raises `sqlite3.Error`.
        """
        with self._mutex, sqlite_file.damage_noticed(self.path):
            before = self._acked.get((camera, boot), -1)
            given = max(before, self._given(camera, boot))
            if seq > given and boot == self.boot:
                self._begin_boot()
                return False

            # Count what is newly acknowledged.
            seq = min(seq, given)
            newly = self._count(
                "camera = ? AND boot = ? AND seq > ? AND seq <= ?", camera, boot, before, seq
            )
            if newly:
                self._kept += newly
                self._acked[camera, boot] = seq
                self._unwritten.add((camera, boot))
                if boot != self.boot:
                    # Without room it is written with the next events.
                    with contextlib.suppress(sqlite3.OperationalError):
                        self._write_acks()
            return True

    def batch(self, camera: str, boot: str | None, from_seq: int, events_max: int) -> SpoolBatch:
        """Return events of ``camera`` for a daemon, at most ``events_max``.

        They are those of ``boot`` from ``from_seq`` on, acknowledged or not, or those of the oldest
        other boot that are not acknowledged; by turns if there are both. Without ``boot`` they are
        those of the oldest boot.
        """
        with self._mutex, sqlite_file.damage_noticed(self.path):
            chosen, start = self._choose(camera, boot, from_seq)
            acked = self._acked.get((camera, chosen))
            rows, more = self._good_rows(camera, chosen, start, events_max)
            return SpoolBatch(
                camera=camera,
                boot=chosen,
                first=self._first(camera, chosen, -1 if acked is None or start <= acked else acked),
                dropped=self.dropped,
                more=more,
                events=rows,
                acked=acked,
            )

    def cameras(self) -> list[str]:
        """Return the cameras with events that are not acknowledged."""
        with self._mutex, sqlite_file.damage_noticed(self.path):
            cameras = self._db.execute("SELECT DISTINCT camera FROM event").fetchall()
            return [camera for (camera,) in cameras if self._waiting(camera)]

    def statistics(self) -> dict[str, int]:
        """Return counters for the status."""
        with self._mutex, sqlite_file.damage_noticed(self.path):
            return {
                "unacknowledged": self._held - self._kept,
                "kept": self._kept,
                "dropped": self.dropped,
                "damaged_events": len(self._damaged),
                "damaged_files": len(sqlite_file.damaged_files(self.path)),
            }

    def __len__(self) -> int:
        """Return the number of events that are not acknowledged."""
        with self._mutex, sqlite_file.damage_noticed(self.path):
            return self._held - self._kept

    def close(self) -> None:
        """Close the file; its events stay for the next time."""
        with self._mutex, sqlite_file.damage_noticed(self.path):
            try:
                with sqlite_file.transaction(self._db):
                    self._write_down()
            except sqlite3.ProgrammingError:
                pass  # closed already
            except sqlite3.Error as error:
                log.warning("the spool %s could not be closed properly: %s", self.path, error)
            self._db.close()
            self._lock.close()

    def _number(self, events: Sequence[Event]) -> tuple[list[Event], dict[str, int]]:
        """Return the events with boot and seq, and the highest seq by camera."""
        seqs = dict(self._seqs)
        numbered = []
        for event in events:
            if event.boot is None or event.seq is None:
                seq = seqs[event.camera] = seqs.get(event.camera, 0) + 1
                event = msgspec.structs.replace(event, boot=self.boot, seq=seq)
            numbered.append(event)
        return numbered, seqs

    def _given(self, camera: str, boot: str) -> int:
        """Return the highest seq of a boot, stored or given in the current boot; -1 if none."""
        numbered = self._seqs.get(camera, 0) if boot == self.boot else -1
        newest = "SELECT COALESCE(MAX(seq), -1) FROM event WHERE camera = ? AND boot = ?"
        return max(numbered, int(self._db.execute(newest, (camera, boot)).fetchone()[0]))

    def _begin_boot(self) -> None:
        """Begin a new boot, after events were acknowledged that the current one never had."""
        self._boots_begun += 1
        self.boot, self._seqs, self._boot_written = (
            f"{self._first_boot}.{self._boots_begun}",
            {},
            False,
        )
        log.error(
            "more events of the spool %s are acknowledged than this boot has had "
            "(was this machine restored?): a new boot begins",
            self.path,
        )

    def _write_down(self) -> None:
        """Write the boot and acknowledgements not in the file yet, within a transaction."""
        if not self._boot_written:
            spool_schema.write_boot(self._db, self.boot)
        for camera, boot in self._unwritten:
            spool_schema.set_row(self._db, "acked", camera, boot, self._acked[camera, boot])

    def _write_acks(self) -> None:
        """Write them in a transaction of their own."""
        with sqlite_file.transaction(self._db):
            self._write_down()
        self._boot_written = True
        self._unwritten.clear()

    def _ask_the_file(self, again: list[Event]) -> None:
        """After an error, look which events were stored after all, and keep their numbers.

        again: the events to be stored next; if the stored ones are among them, they get the same
            numbers again.
        """
        given = {_row(event) for event in again}
        self._boot_written = spool_schema.meta(self._db, "boot") == self.boot
        stored = spool_schema.counts(self._db) if self._boot_written else {}
        for camera, last in stored.items():
            ahead = self._db.execute(
                "SELECT camera, boot, seq, raw, crc FROM event"
                " WHERE camera = ? AND boot = ? AND seq > ?",
                (camera, self.boot, self._seqs.get(camera, 0)),
            )
            if not given.issuperset(ahead):
                self._seqs[camera] = last
        self._recount()

    def _make_room(self, held: int) -> tuple[int, int]:
        """Delete surplus events, within a transaction.

        Returns how many acknowledged and how many other events were deleted.
        """

        # First acknowledged events beyond their limit, with some slack so that this is rare.
        surplus = 0 if self._kept <= self._kept_max * 9 // 8 else self._kept - self._kept_max
        forgotten = self._forget(min(surplus, _DELETED_MAX))

        # Then acknowledged events, if there are too many events or bytes.
        surplus = min(self._surplus(held - forgotten), _DELETED_MAX)
        forgotten += self._forget(min(surplus, self._kept - forgotten))

        # Then the oldest events of all.
        only_others = surplus > 0 and forgotten == self._kept
        dropped = min(self._surplus(held - forgotten), _DELETED_MAX) if only_others else 0
        if dropped:
            self._db.execute(
                "DELETE FROM event WHERE id IN (SELECT id FROM event ORDER BY id LIMIT ?)",
                (dropped,),
            )
            spool_schema.set_row(self._db, "meta", "dropped", str(self.dropped + dropped))
        return forgotten, dropped

    def _forget(self, count: int) -> int:
        """Delete the oldest acknowledged events, at most ``count``; return how many."""
        if count <= 0:
            return 0
        gone = self._db.execute(
            "DELETE FROM event WHERE id IN"
            " (SELECT event.id FROM event JOIN acked USING (camera, boot)"
            " WHERE event.seq <= acked.seq ORDER BY event.id LIMIT ?)",
            (count,),
        ).rowcount
        self._db.execute(
            "DELETE FROM acked WHERE boot != ? AND NOT EXISTS"
            " (SELECT 1 FROM event WHERE event.camera = acked.camera AND event.boot = acked.boot)",
            (self.boot,),
        )
        return gone

    def _surplus(self, held: int) -> int:
        """Return the number of events to delete to keep to the limits of events and bytes."""
        pages, free, size = (
            self._db.execute(f"PRAGMA {name}").fetchone()[0]
            for name in ("page_count", "freelist_count", "page_size")
        )
        used = (pages - free) * size
        too_large = -(-held * (used - self._bytes_max) // used) if used > self._bytes_max else 0
        return min(held, max(held - self._events_max, too_large, 0))

    def _choose(self, camera: str, boot: str | None, from_seq: int) -> tuple[str, int]:
        """Return the boot to answer from, and the first seq of it."""
        if boot is None:
            ages = [(self._oldest(camera, one, -1), one) for one in self._boots(camera)]
            return min(ages)[1] if ages else self.boot, -1
        others = [one for one in self._waiting(camera) if one != boot]
        mine = self._oldest(camera, boot, from_seq - 1) is not None
        self._asked_last = mine and not (others and self._asked_last)
        if self._asked_last or not others:
            return boot, from_seq
        return others[0], self._acked.get((camera, others[0]), -1) + 1

    def _waiting(self, camera: str) -> list[str]:
        """Return the boots with unacknowledged events of ``camera``, the oldest first."""
        found = []
        for boot in self._boots(camera):
            oldest = self._oldest(camera, boot, self._acked.get((camera, boot), -1))
            if oldest is not None:
                found.append((oldest, boot))
        return [boot for _, boot in sorted(found)]

    def _boots(self, camera: str) -> list[str]:
        """Return the boots with events of ``camera``; each takes one look-up in the index."""
        boots: list[str] = []
        following = "SELECT MIN(boot) FROM event WHERE camera = ? AND boot >= ''"
        while (
            boot := self._db.execute(following, (camera, *boots[-1:])).fetchone()[0]
        ) is not None:
            boots.append(boot)
            following = "SELECT MIN(boot) FROM event WHERE camera = ? AND boot > ?"
        return boots

    def _oldest(self, camera: str, boot: str, after_seq: int) -> int | None:
        """Return the id of the first event after ``after_seq``; None if there is none."""
        row = self._db.execute(
            "SELECT id FROM event WHERE camera = ? AND boot = ? AND seq > ? ORDER BY seq LIMIT 1",
            (camera, boot, after_seq),
        ).fetchone()
        return None if row is None else int(row[0])

    def _first(self, camera: str, boot: str, after_seq: int) -> int:
        """Return the lowest seq after ``after_seq`` that is stored or will be given next."""
        row = self._db.execute(
            "SELECT MIN(seq) FROM event WHERE camera = ? AND boot = ? AND seq > ?",
            (camera, boot, after_seq),
        ).fetchone()
        if row[0] is not None:
            return int(row[0])
        known = self._acked.get((camera, boot), -1)
        return 1 + (max(known, self._seqs.get(camera, 0)) if boot == self.boot else known)

    def _good_rows(
        self, camera: str, boot: str, start: int, events_max: int
    ) -> tuple[list[tuple[int, bytes]], bool]:
        """Return at most ``events_max`` undamaged events as (seq, bytes); and if there are more.

        Each damaged event is logged once and left out.
        """
        rows: list[tuple[int, bytes]] = []
        for id_, *row in self._db.execute(
            "SELECT id, camera, boot, seq, raw, crc FROM event"
            " WHERE camera = ? AND boot = ? AND seq >= ? ORDER BY seq",
            (camera, boot, start),
        ):
            if sqlite_file.crc(*row[:-1]) != row[-1]:
                if id_ not in self._damaged:
                    self._damaged.add(id_)
                    log.error(
                        "event %s of camera %s in the spool %s is damaged",
                        row[2],
                        camera,
                        self.path,
                    )
            elif len(rows) == events_max:
                return rows, True
            else:
                rows.append((row[2], row[3]))
        return rows, False

    def _recount(self) -> None:
        """Count the events in the file."""
        self._held = self._count("TRUE")
        self._kept = sum(
            self._count("camera = ? AND boot = ? AND seq <= ?", *stream, seq)
            for stream, seq in self._acked.items()
        )
        self.dropped = int(spool_schema.meta(self._db, "dropped") or 0)
        """Events dropped because the spool was full, since its file was created."""

    def _count(self, where: str, *parameters: str | int) -> int:
        """Return the number of events that satisfy an SQL condition."""
        return int(
            self._db.execute(f"SELECT COUNT(*) FROM event WHERE {where}", parameters).fetchone()[0]
        )


def _row(event: Event) -> tuple[str, str | None, int | None, bytes, int]:
    """Return the row of the table ``event`` for an event."""
    raw = codec.to_msgpack(event)
    return (
        event.camera,
        event.boot,
        event.seq,
        raw,
        sqlite_file.crc(event.camera, event.boot, event.seq, raw),
    )


def spool_path(directory: Path, site: str, name: str) -> Path:
    """Return the path of the spool ``name`` of a site, below the state directory ``directory``."""
    return directory / f"spools-of-{site}" / f"{name}.db"


def open_spool(directory: Path, site: str, name: str, limits: Limits) -> Spool:
    """Open the spool of a publishing process, below the state directory. Raises `StateError`.

    name: name of the spool.
    limits: the limits of events and bytes.
    """
    path = spool_path(directory, site, name)
    boot = clock.ulid(clock.wall())
    return Spool(
        path, boot, limits.spool_events_max, limits.spool_bytes_max, limits.spool_kept_events
    )
