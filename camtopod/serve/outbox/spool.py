"""A publisher's spool: events wait here, on disk, until the daemons of all sites have stored them.

A new *boot* begins each time a spool is opened, and the events of each camera are numbered within
it, so that a file restored from an older copy never gives the same number to a second event. Each
site has a queue of each camera over all boots, in the order of storing (`site_queue`), with a mark
of each boot: the number up to which its daemon has the events. It moves as the daemon says,
forwards or backwards: the newest stored events are kept, for a daemon whose journal came back
older.

A spool belongs to the site that owns its cameras; others may hear some of them.
"""

from __future__ import annotations

import contextlib
import logging
import math
import sqlite3
import threading
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
from pathlib import Path

from msgspec.structs import replace

from camtopod import codec
from camtopod.config import Limits
from camtopod.records import Event
from camtopod.serve.outbox import spool_tables
from camtopod.serve.outbox.site_queue import SiteMark, SiteQueue
from camtopod.serve.runtime import Rejects
from camtopod.serve.storage import StateError, sqlite_file

log = logging.getLogger(__name__)

KEPT_EVENTS_MAX = 10_000
"""Maximum number of stored events of one camera that are kept, the newest."""
_DEFAULT = Limits()

OWNER = ""
"""Name, in a spool, of the site that owns its cameras."""
SitesOf = Callable[[str], Sequence[str]]
"""Function that returns the sites to which a camera delivers, its owner first."""

_BOOTS = "SELECT camera, boot FROM event GROUP BY camera, boot ORDER BY MIN(id)"
_MARKS = "SELECT camera, boot, site, name, base, last, have FROM mark ORDER BY 1, 2, 3, base, last"
_FORGET = "DELETE FROM mark WHERE camera = ? AND boot = ? AND site = ?"
_BOOT = "event WHERE camera = ? AND boot = ?"
_STORED = """
SELECT id FROM event WHERE 0 = (
    SELECT MAX(seq > have AND seq <= last) FROM mark
    WHERE mark.camera = event.camera AND mark.boot = event.boot)
"""
"""Rows that all sites have stored, as each site of a camera has marks of all its boots."""


def owner_alone(camera: str) -> Sequence[str]:
    """Return the sites of a camera that delivers to its owner only."""
    return (OWNER,)


class Spool:
    """A spool file, for one publishing process. Thread-safe.

    boot: name of the boot that begins.
    events_max: maximum number of events in the file.
    bytes_max: largest size of the file, in bytes.
    kept_max: maximum number of stored events of one camera that are kept.
    sites_of: returns the sites to which a camera delivers, its owner first.

    A hundredth more may be in the file. When it is full the oldest events that all sites have
    stored are deleted, then the oldest, counted in the `dropped` of the sites for which they wait.
    A damaged file is set aside, and its readable events are copied to the new one. Raises
    `StateError` on opening, and `sqlite_file.Damaged` as soon as damage shows; methods that read or
    write the file raise `sqlite3.Error`.
    """

    def __init__(
        self,
        path: Path,
        boot: str,
        events_max: int,
        bytes_max: int = _DEFAULT.spool_bytes_max,
        kept_max: int = KEPT_EVENTS_MAX,
        sites_of: SitesOf = owner_alone,
    ) -> None:
        self.path = path
        """Path of the file."""
        self.boot = boot
        """The boot in which this process numbers events."""
        self.damage_count = 0
        """Damaged events that were found, since the start."""
        self.rejects = Rejects()
        """Events that were refused, as the daemon would reject them."""
        self._events_max = events_max
        self._bytes_max = bytes_max
        self._kept_max = kept_max
        self._sites_of = sites_of
        # (camera, boot, site) of marks in the file without events, or of a site that was left out.
        self._stale: list[tuple[str, str, str]] = []
        self._queues = {OWNER: SiteQueue(self, OWNER)}
        self.boots: set[tuple[str, str]] = set()  # (camera, boot) with events in the file
        # (camera, boot) of which this process was given events -> the highest number of them.
        self.tops: dict[tuple[str, str], int] = {}
        # (camera, boot) -> a number that none of the events in the file is above.
        self._ceilings: dict[tuple[str, str], int] = {}
        self._additions = math.inf  # events since the limits were looked at
        self._mutex = threading.RLock()
        self._lock = sqlite_file.Lock(path.with_suffix(".lock"))

        # Open the file; release everything after an error.
        with contextlib.ExitStack() as undo:
            undo.callback(self._lock.close)
            try:
                self._db, _ = sqlite_file.connect_or_recreate(
                    path, spool_tables.SCHEMA, spool_tables.FORMAT, needed_tables=("meta", "mark")
                )
                undo.callback(self._db.close)
                with self.using():
                    spool_tables.rescue(self._db, path)
                    self._load()
            except sqlite3.Error as error:
                raise StateError(
                    f"cannot read {path}: {error}; the file was not modified"
                ) from None
            undo.pop_all()

    def append(self, events: Sequence[Event]) -> list[Event]:
        """Store events in one transaction; return the new ones with boot and seq.

        Each gets this spool's boot and the next number, unless it brings a boot of its own and a
        number that is above the earlier ones of that boot. An event that is here already (same
        camera, boot and seq) is not stored again. What the daemon would reject is refused.

        After an error the events may be stored or not, and the next call must repeat them first.
        """
        with self.using():
            batch, rows, refusals = self._number(events)
            boots = {(camera, boot) for camera, boot, *_ in rows}
            for camera, boot in boots:
                for site in self.sites(camera):
                    self.queue(site).add(camera, boot)
            for queue in self._queues.values():
                queue.counts.clear()  # after an error, too
            with self._writing():
                self._db.executemany(spool_tables.INSERT, rows)
                drops = self._make_room(len(rows))
            for camera, boot, seq, *_ in rows:
                self.tops[camera, boot] = seq
            self.boots |= boots

        # Report the events that were left out.
        for camera, error in refusals:
            self.rejects.add(error.reason, f"event of {camera}", str(error))
        for site, count in drops.items():
            if not self.queue(site).dropped:
                beginning = f"site {site}: " if site else ""
                full = "the spool %s is full: its oldest events are dropped"
                log.error(f"{beginning}{full}", self.path)
            self.queue(site).dropped += count
        return batch

    def sites(self, camera: str) -> list[str]:
        """Return the sites to which ``camera`` delivers: `OWNER`, and others by their names."""
        return [OWNER, *self._sites_of(camera)[1:]]

    def queue(self, site: str = OWNER) -> SiteQueue:
        """Return the queue of events that wait for a site."""
        with self._mutex:
            if site not in self._queues:
                self._queues[site] = SiteQueue(self, site)
            return self._queues[site]

    def waiting(self, own: bool = False) -> int:
        """Return the number of events that some site has not stored, as far as is known.

        Of each camera, those that wait for the site for which most wait.

        own: only those of boots of which this process was given events.
        """
        with self.using():
            return sum(
                max(self.queue(site).count(camera, own) for site in self.sites(camera))
                for camera in list(self.queue().marks)
            )

    @property
    def dropped(self) -> int:
        """Events that were deleted before they were stored, since the start, by all sites."""
        return sum(queue.dropped for queue in list(self._queues.values()))

    def adopt(self, path: Path) -> None:
        """Move the events of another spool, which no process has open, into this one."""
        source = Spool(path, self.boot, self._events_max, sites_of=self._sites_of)
        with contextlib.closing(source), self.using():
            with self._writing():
                spool_tables.copy(
                    self._db,
                    source._db.execute("SELECT * FROM event ORDER BY id"),
                    source._db.execute("SELECT * FROM mark"),
                )
            self._load()
            for suffix in ("", "-wal", "-shm"):  # while no other process can open it
                Path(f"{path}{suffix}").unlink(missing_ok=True)

    def statistics(self) -> dict[str, int]:
        """Return counters for the status."""
        backlog = self.waiting()
        with self.using():
            return {
                "waiting": backlog,
                "kept": self.count("event") - backlog,
                "dropped": self.dropped,
                "refused": self.rejects.counts.total(),
                "damaged_events": self.damage_count,
                "damaged_files": len(sqlite_file.damaged_files(self.path)),
            }

    def close(self) -> None:
        """Close the file; its events stay for the next time, and are still counted as `waiting`.

        May be called twice.
        """
        with contextlib.suppress(sqlite3.Error, StateError), self.using(), self._writing():
            self.waiting()  # from now on it is known without the file
        self._db.close()
        self._lock.close()

    # What follows is used within `using`, by this class and its queues.

    @contextlib.contextmanager
    def using(self) -> Iterator[sqlite3.Connection]:
        """Return the database, which no other thread uses while the block runs."""
        with self._mutex, sqlite_file.damage_noticed(self.path):
            yield self._db

    def count(self, rows: str, *parameters: str | int) -> int:
        """Return the number of these rows."""
        return int(self._db.execute(f"SELECT COUNT(*) FROM {rows}", parameters).fetchone()[0])

    def delete_damaged(self, camera: str, ids: Sequence[int]) -> None:
        """Delete damaged rows of ``camera``."""
        for queue in self._queues.values():
            queue.counts.clear()
        with sqlite_file.transaction(self._db):
            self._db.executemany("DELETE FROM event WHERE id = ?", [(id_,) for id_ in ids])
        self.damage_count += len(ids)
        log.error("%s: %d events of %s are damaged", self.path, len(ids), camera)

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Run the block in a transaction, which writes the marks that have moved, too."""
        queues = list(self._queues.values())
        with sqlite_file.transaction(self._db):
            self._db.executemany(_FORGET, self._stale)
            for queue in queues:
                queue.write_marks(self._db)
            yield
        for queue in queues:
            queue.unwritten.clear()
        self._stale.clear()

    def _load(self) -> None:
        """Read which boots there are, and their marks."""
        self._ceilings.clear()
        self._queues = {OWNER: SiteQueue(self, OWNER)}
        marks = {
            key: {row[3]: SiteMark(key[1], *row[4:]) for row in rows}
            for key, rows in groupby(self._db.execute(_MARKS).fetchall(), lambda row: row[:3])
        }
        boots = self._db.execute(_BOOTS).fetchall()
        self.boots = {*boots}
        for camera, boot in boots:
            for site in self.sites(camera):
                self.queue(site).marks[camera].update(marks.pop((camera, boot, site), {}))
                self.queue(site).add(camera, boot)
        self._stale = list(marks)

    def _number(
        self, events: Sequence[Event]
    ) -> tuple[list[Event], list[spool_tables.EventRow], list[tuple[str, codec.Rejected]]]:
        """Return the new events with boot and seq, their rows, and (camera, error) of bad ones."""
        tops = self.tops.copy()
        batch: list[Event] = []
        rows: list[spool_tables.EventRow] = []
        numbers: set[tuple[str, str, int]] = set()
        refusals = []
        for event in events:
            camera, boot, seq = event.camera, event.boot, event.seq
            if boot and seq is not None:
                if seq <= self._ceiling(camera, boot):
                    count = self.count(f"{_BOOT} AND seq = ?", camera, boot, seq)
                    if count or (camera, boot, seq) in numbers:
                        self.tops.setdefault((camera, boot), 0)
                        continue
                if seq <= tops.get((camera, boot), 0):
                    boot = None
            if not boot or seq is None:
                boot = self.boot
                seq = 1 + tops.get((camera, boot), 0)
            if event.spooled or (boot, seq) != (event.boot, event.seq):
                event = replace(event, boot=boot, seq=seq, spooled=False)
            row = spool_tables.row(event)
            try:
                codec.event_from_bytes(row[3])  # as the daemon does
            except codec.Rejected as error:
                refusals.append((camera, error))
                continue
            tops[camera, boot] = seq
            self._ceilings[camera, boot] = max(seq, self._ceilings.get((camera, boot), seq))
            numbers.add((camera, boot, seq))
            batch.append(event)
            rows.append(row)
        return batch, rows, refusals

    def _ceiling(self, camera: str, boot: str) -> int:
        """Return a number that no event of a boot, in the file or on its way there, is above."""
        ceiling = self._ceilings.get((camera, boot))
        if ceiling is None:
            highest = f"SELECT MAX(seq) FROM {_BOOT}"
            ceiling = self._db.execute(highest, (camera, boot)).fetchone()[0] or 0
            self._ceilings[camera, boot] = ceiling
        return ceiling

    def _make_room(self, additions: int) -> dict[str, int]:
        """Delete surplus events, within a transaction; return how many waited for each site.

        additions: number of events just added. The limits are looked at now and then.
        """
        self._additions += additions
        if self._additions < min(self._events_max, 10 * self._kept_max) // 100:
            return {}

        # Stored events of each camera beyond their limit, with some slack so that this is rare.
        large = "SELECT camera FROM event GROUP BY camera HAVING COUNT(*) > ?"
        for (camera,) in self._db.execute(large, (self._kept_max * 9 // 8,)).fetchall():
            self._db.execute(
                f"DELETE FROM event WHERE id IN"
                f" ({_STORED} AND camera = ? ORDER BY id DESC LIMIT -1 OFFSET ?)",
                (camera, self._kept_max),
            )
        self._additions = 0

        # The oldest ones if there are too many events or bytes.
        count = self.count("event")
        size = sqlite_file.used_bytes(self._db)
        too_large = -(-count * (size - self._bytes_max) // size)
        surplus = min(count, max(count - self._events_max, too_large))
        if surplus <= 0:
            return {}
        delete = f"DELETE FROM event WHERE id IN ({_STORED} ORDER BY id LIMIT ?)"
        surplus -= self._db.execute(delete, (surplus,)).rowcount
        if surplus <= 0:
            return {}
        nth = self._db.execute("SELECT id FROM event ORDER BY id LIMIT 1 OFFSET ?", (surplus - 1,))
        [last_id] = nth.fetchone()
        drops = {site: queue.waiting_until(last_id) for site, queue in self._queues.items()}
        self._db.execute("DELETE FROM event WHERE id <= ?", (last_id,))
        return {site: number for site, number in drops.items() if number}
