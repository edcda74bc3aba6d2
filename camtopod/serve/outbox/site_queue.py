"""The queue of a spool for one site: how far the site has stored each boot, and the next events.

The rows of a spool are never renumbered. A site knows those of a boot by the boot's name and their
numbers, unless the machine was set back: then the rows that it had not stored, and those that
follow, have another name there and numbers from 1, while other sites go on with the first.
"""

from __future__ import annotations

import logging
import sqlite3
from collections import defaultdict
from typing import TYPE_CHECKING

from msgspec import Struct
from msgspec.structs import replace

from camtopod import codec
from camtopod.records import Event
from camtopod.serve.requests import BATCH_BYTES_MAX, BOOTS_MAX, SEQ_MAX
from camtopod.serve.storage import sqlite_file

if TYPE_CHECKING:
    from camtopod.serve.outbox.spool import Spool

log = logging.getLogger(__name__)

_WAITING = "event WHERE camera = ? AND boot = ? AND seq > ? AND seq <= ?"
_WRITE = "INSERT OR REPLACE INTO mark VALUES (?, ?, ?, ?, ?, ?, ?, ?)"


class SiteMark(Struct, frozen=True):
    """Rows of a boot that a site knows by one name, and how far it has stored them.

    boot: the boot of the rows.
    base, last: their numbers in the spool are above ``base``, and at most ``last``; at the site
        they are counted from 1.
    have: the number in the spool up to which they are stored; ``base`` if none is.
    """

    boot: str
    base: int = 0
    last: int = SEQ_MAX
    have: int = 0

    @property
    def waiting(self) -> tuple[str, int, int]:
        """Parameters that follow the camera's in `_WAITING`."""
        return self.boot, self.have, self.last


class SiteQueue:
    """The queue of ``spool`` for ``site``, which `Spool.queue` makes. Thread-safe.

    Methods that read or write the file raise `sqlite3.Error` and `sqlite_file.Damaged`. The spool
    itself uses `marks`, `unwritten`, `counts` and the last methods, within `Spool.using`.
    """

    def __init__(self, spool: Spool, site: str) -> None:
        self.site = site
        self.dropped = 0
        """Events that were deleted before the site had stored them, since the start."""
        self._spool = spool
        # Camera -> name of a boot at the site, oldest first.
        self.marks: defaultdict[str, dict[str, SiteMark]] = defaultdict(dict)
        self.unwritten: set[tuple[str, str]] = set()  # (camera, name) of marks that have moved
        # (camera, name) -> number of events that wait, where it is known.
        self.counts: dict[tuple[str, str], int] = {}
        self._later_names: dict[str, str] = {}

    def boot(self, camera: str) -> str:
        """Return the name of the boot in which this process numbers the events of ``camera``."""
        return self._later_names.get(camera, self._spool.boot)

    def boots(self, camera: str) -> list[str]:
        """Return the boots of ``camera`` in the spool, oldest first; this process's is last.

        At most `BOOTS_MAX`, the newest.
        """
        with self._spool.using():
            names = [name for name in self.marks[camera] if name != self.boot(camera)]
            return [*names[1 - BOOTS_MAX :], self.boot(camera)]

    def cameras(self) -> list[str]:
        """Return the cameras with events in the spool that deliver to the site."""
        with self._spool.using():
            return [camera for camera, marks in self.marks.items() if marks]

    def mark(self, camera: str, boot: str) -> int:
        """Return the number up to which the site has stored a boot, as far as is known."""
        with self._spool.using():
            mark = self.marks[camera].get(boot)
            return 0 if mark is None else mark.have - mark.base

    def is_own(self, camera: str, boot: str | None = None) -> bool:
        """Return True if this process was given events of a boot, or of any boot of a camera."""
        if boot is None:
            return any(name == camera for name, _ in self._spool.tops.copy())
        mark = self.marks[camera].get(boot)
        return (camera, mark.boot if mark else boot) in self._spool.tops

    def waiting(self, camera: str | None = None, own: bool = False) -> int:
        """Return the number of events that the site has not stored, as far as is known.

        own: only those of boots of which this process was given events.
        """
        with self._spool.using():
            cameras = list(self.marks) if camera is None else [camera]
            return sum(self.count(name, own) for name in cameras)

    def next_batch(self, camera: str, limit: int) -> tuple[str, list[tuple[int, bytes]]] | None:
        """Return boot and (seq, bytes) of the events of ``camera`` to be sent next, by rising seq.

        They are at most ``limit`` and `BATCH_BYTES_MAX`, of the oldest boot of which events wait. A
        damaged event is logged and deleted. None if no event waits.
        """
        with self._spool.using() as database:
            for name, mark in self.marks[camera].items():
                events: list[tuple[int, bytes]] = []
                bad_rows = []
                size = 0
                statement = f"SELECT id, seq, raw, crc FROM {_WAITING} ORDER BY seq"
                rows = database.execute(statement, (camera, *mark.waiting))
                for id_, seq, raw, crc in rows:
                    if crc != sqlite_file.crc(camera, mark.boot, seq, raw):
                        bad_rows.append(id_)
                        continue
                    size += len(raw)
                    if len(events) == limit or (events and size > BATCH_BYTES_MAX):
                        break
                    if name != mark.boot:
                        event = codec.event_from_bytes(raw)
                        raw = codec.to_msgpack(replace(event, boot=name, seq=seq - mark.base))
                    events.append((seq - mark.base, raw))

                if bad_rows:
                    self._spool.delete_damaged(camera, bad_rows)
                if events:
                    return name, events
            return None

    def numbered(self, event: Event) -> Event:
        """Return an event that was just stored, with its boot and number at the site."""
        with self._spool.using():
            name = self.boot(event.camera)
            mark = self.marks[event.camera].get(name)
        if event.seq is None or mark is None or event.boot != mark.boot:
            return event
        return replace(event, boot=name, seq=event.seq - mark.base)

    def have(self, camera: str, boot: str, seq: int) -> None:
        """Note that the site has stored a boot up to ``seq``, and nothing beyond it.

        This is written with the next events or on closing: after a kill the daemon says it again.
        """
        with self._spool.using():
            mark = self.marks[camera].get(boot)
            if mark is None:
                return
            row = min(mark.base + seq, mark.last)
            if row == mark.have:
                return
            if mark.have < row and (camera, boot) in self.counts:
                passed_rows = (camera, mark.boot, mark.have, row)
                self.counts[camera, boot] -= self._spool.count(_WAITING, *passed_rows)
            else:
                self.counts.pop((camera, boot), None)
            self.marks[camera][boot] = replace(mark, have=row)
            self.unwritten.add((camera, boot))

    def begin_boot(self, camera: str, new: str) -> None:
        """Name the waiting events of this process's boot, and later ones, ``new`` at the site.

        The name must never have been used: a machine that is set back again would repeat it.
        """
        with self._spool.using() as database:
            old = self.boot(camera)
            mark = self.marks[camera].get(old, SiteMark(self._spool.boot))
            marks = {old: replace(mark, last=mark.have), new: replace(mark, base=mark.have)}
            with sqlite_file.transaction(database):
                for name, new_mark in marks.items():
                    self._write(database, camera, name, new_mark)
            self.marks[camera].update(marks)
            self._later_names[camera] = new
            self.counts.clear()
        path = self._spool.path
        log.error("%s: the daemon has later events of %s: a new boot begins", path, camera)

    def drop(self, camera: str) -> None:
        """Delete the events of ``camera`` that wait, and count them as dropped."""
        with self._spool.using() as database:
            self.counts.clear()
            for mark in self.marks[camera].values():
                rows = database.execute(f"DELETE FROM {_WAITING}", (camera, *mark.waiting))
                self.dropped += rows.rowcount

    def count(self, camera: str, own: bool) -> int:
        """Return `waiting` of a camera."""
        boots = self._spool.tops if own else self._spool.boots
        total = 0
        for name, mark in self.marks[camera].items():
            if (camera, mark.boot) in boots:
                if (camera, name) not in self.counts:
                    self.counts[camera, name] = self._spool.count(_WAITING, camera, *mark.waiting)
                total += self.counts[camera, name]
        return total

    def add(self, camera: str, boot: str) -> None:
        """Take a boot that has events, of which nothing is stored, unless it is known."""
        if not any(mark.boot == boot for mark in self.marks[camera].values()):
            self.marks[camera][boot] = SiteMark(boot)
            self.unwritten.add((camera, boot))

    def write_marks(self, database: sqlite3.Connection) -> None:
        """Write the marks that have moved, within a transaction."""
        for camera, name in self.unwritten:
            self._write(database, camera, name, self.marks[camera][name])

    def waiting_until(self, id_: int) -> int:
        """Return the number of events that wait among the oldest rows, up to this id."""
        return sum(
            self._spool.count(f"{_WAITING} AND id <= ?", camera, *mark.waiting, id_)
            for camera, marks in self.marks.items()
            for mark in marks.values()
        )

    def _write(self, database: sqlite3.Connection, camera: str, name: str, mark: SiteMark) -> None:
        row = (camera, mark.boot, self.site, name, mark.base, mark.last, mark.have)
        database.execute(_WRITE, (*row, sqlite_file.crc(*row)))
