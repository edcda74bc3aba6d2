"""A publisher's spool: events wait here, on disk, until the daemon has stored them.

Each camera has one queue over all boots, in the order of storing. A new *boot* begins each time a
spool is opened, and the events of each camera are numbered within it, so that a file restored from
an older copy never gives the same number to a second event. Of each boot the spool keeps a mark:
the number up to which the daemon has the events. It moves as the daemon says, forwards or
backwards: the newest stored events are kept, for a daemon whose journal came back older.

A spool belongs to one site.
"""

from __future__ import annotations

import contextlib
import logging
import sqlite3
import threading
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from camtopod import codec
from camtopod.config import Limits
from camtopod.records import Event
from camtopod.serve.outbox import spool_tables
from camtopod.serve.requests import BATCH_BYTES_MAX, BOOTS_MAX
from camtopod.serve.runtime import Rejects
from camtopod.serve.storage import StateError, sqlite_file

log = logging.getLogger(__name__)

KEPT_EVENTS_MAX = 10_000
"""Maximum number of stored events of one camera that are kept, the newest."""
_DELETED_MAX = 5_000
"""Most events deleted at a time, as the log grows with the transaction; a full spool adds fewer."""
_DEFAULT = Limits()

_LOAD = """
SELECT event.camera, event.boot, COALESCE(have, 0), SUM(seq > COALESCE(have, 0)),
    SUM(seq <= COALESCE(have, 0))
FROM event LEFT JOIN mark USING (camera, boot) GROUP BY camera, boot ORDER BY MIN(id)
"""
_DELETE = """
DELETE FROM event WHERE id IN (
    SELECT id FROM (
        SELECT id, event.camera, seq <= COALESCE(have, 0) AS stored
        FROM event LEFT JOIN mark USING (camera, boot))
    WHERE {} ORDER BY id LIMIT ?)
RETURNING camera, boot, seq
"""
_WAITING = "FROM event WHERE camera = ? AND boot = ? AND seq > ? ORDER BY seq"


class _Boot(Struct):
    """The mark of one boot of a camera, and how many of its events are above it, and not."""

    have: int = 0
    waiting: int = 0
    stored: int = 0

    def count(self, seq: int, change: int) -> None:
        """Count an event that was added (``change`` 1) or deleted (-1)."""
        if seq > self.have:
            self.waiting += change
        else:
            self.stored += change


class Spool:
    """A spool file, for one publishing process. Thread-safe.

    boot: name of the boot that begins.
    events_max: maximum number of events in the file.
    bytes_max: largest size of the file, in bytes.
    kept_max: maximum number of stored events of one camera that are kept.

    When the file is full the oldest stored events are deleted, then the oldest that wait, counted
    in `dropped`. A damaged file is set aside, and its readable events are copied to the new one.
    Raises `StateError` on opening, and `sqlite_file.Damaged` as soon as damage shows; methods that
    read or write the file raise `sqlite3.Error`.
    """

    def __init__(
        self,
        path: Path,
        boot: str,
        events_max: int,
        bytes_max: int = _DEFAULT.spool_bytes_max,
        kept_max: int = KEPT_EVENTS_MAX,
    ) -> None:
        self.path = path
        """Path of the file."""
        self.dropped = 0
        """Events that were deleted before they were stored, since the start."""
        self.damaged = 0
        """Damaged events that were found, since the start."""
        self.rejects = Rejects()
        """Events that were refused, as the daemon would reject them."""
        self._events_max = events_max
        self._bytes_max = bytes_max
        self._kept_max = kept_max
        self._first_boot = boot
        self._later_boots: dict[str, str] = {}
        self._boots_begun = 0
        self._boots: defaultdict[str, dict[str, _Boot]] = defaultdict(dict)
        # (camera, boot) of which this process was given events -> the highest number of them.
        self._tops: dict[tuple[str, str], int] = {}
        self._unwritten: set[tuple[str, str]] = set()
        self._sure = False
        self._said_full = False
        self._mutex = threading.Lock()
        self._lock = sqlite_file.Lock(path.with_suffix(".lock"))

        # Open the file; release everything after an error.
        with contextlib.ExitStack() as undo:
            undo.callback(self._lock.close)
            try:
                self._db = spool_tables.open_file(path)
                undo.callback(self._db.close)
                with self._using():
                    pass
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
        with self._using():
            numbered, refused = self._number(events)
            rows = [spool_tables.row(event) for event in numbered]
            with self._writing():
                added = self._db.executemany(spool_tables.INSERT, rows).rowcount
                for camera, boot, seq, *_ in rows:
                    self._boots[camera].setdefault(boot, _Boot()).count(seq, 1)
                self._make_room()
            self._sure = not rows or added == len(rows)
            self._tops.update(((camera, boot), seq) for camera, boot, seq, *_ in rows)

        # Report the events that were left out.
        for camera, error in refused:
            self.rejects.add(error.reason, f"event of {camera}", str(error))
        if self.dropped and not self._said_full:
            self._said_full = True
            log.error("the spool %s is full: its oldest events are dropped", self.path)
        return numbered

    def boot(self, camera: str) -> str:
        """Return the boot in which this process numbers the events of ``camera``."""
        return self._later_boots.get(camera, self._first_boot)

    def boots(self, camera: str) -> list[str]:
        """Return the boots of ``camera`` in the spool, oldest first; the one it numbers is last.

        At most `BOOTS_MAX`, the newest.
        """
        with self._using():
            names = [name for name in self._boots[camera] if name != self.boot(camera)]
            return [*names[1 - BOOTS_MAX :], self.boot(camera)]

    def cameras(self) -> list[str]:
        """Return the cameras with events in the spool."""
        with self._using():
            return [camera for camera, boots in self._boots.items() if boots]

    def mark(self, camera: str, boot: str) -> int:
        """Return the number up to which the daemon has stored a boot, as far as is known."""
        with self._using():
            return self._boots[camera].get(boot, _Boot()).have

    def is_own(self, camera: str, boot: str | None = None) -> bool:
        """Return True if this process was given events of a boot, or of any boot of a camera."""
        if boot is None:
            return any(name == camera for name, _ in self._tops.copy())
        return (camera, boot) in self._tops

    def waiting(self, camera: str | None = None, own: bool = False) -> int:
        """Return the number of events that are not stored by the daemon, as far as is known.

        own: only those of boots of which this process was given events.
        """
        with self._using():
            return sum(
                boot.waiting
                for name in (self._boots if camera is None else [camera])
                for boot_name, boot in self._boots[name].items()
                if not own or (name, boot_name) in self._tops
            )

    def next_batch(self, camera: str, most: int) -> tuple[str, list[tuple[int, bytes]]] | None:
        """Return boot and (seq, bytes) of the events of ``camera`` to be sent next, by rising seq.

        They are at most ``most`` and `BATCH_BYTES_MAX`, of the boot of the oldest event that waits.
        A damaged event is logged and deleted. None if no event waits.
        """
        with self._using():
            while (boot := self._oldest_boot(camera)) is not None:
                events: list[tuple[int, bytes]] = []
                damaged = []
                size = 0
                above = camera, boot, self._boots[camera][boot].have
                for id_, *row, crc in self._db.execute(f"SELECT * {_WAITING}", above):
                    if sqlite_file.crc(*row) != crc:
                        damaged.append((id_,))
                        continue
                    size += len(row[-1])
                    if len(events) == most or (events and size > BATCH_BYTES_MAX):
                        break
                    events.append((row[-2], row[-1]))

                if damaged:
                    with self._writing():
                        self._db.executemany("DELETE FROM event WHERE id = ?", damaged)
                    self._load()
                    self.damaged += len(damaged)
                    log.error("%s: %d events of %s are damaged", self.path, len(damaged), camera)
                if events:
                    return boot, events
            return None

    def have(self, camera: str, boot: str, seq: int) -> None:
        """Note that the daemon has stored a boot up to ``seq``, and nothing beyond it.

        This is written with the next events or on closing: after a kill the daemon says it again.
        """
        with self._using():
            self._move_mark(camera, boot, seq)

    def begin_boot(self, camera: str) -> None:
        """Begin another boot for ``camera``, and number what waits of the present one within it."""
        with self._using():
            old = self.boot(camera)
            self._boots_begun += 1
            new = f"{self._first_boot}.{self._boots_begun}"
            above = camera, old, self._boots[camera].get(old, _Boot()).have
            rows = self._db.execute(f"SELECT * {_WAITING}", above).fetchall()
            good = [row for row in rows if sqlite_file.crc(*row[1:-1]) == row[-1]]
            with self._writing():
                for seq, (id_, *_, raw, _) in enumerate(good, 1):
                    event = replace(codec.event_from_bytes(raw), boot=new, seq=seq)
                    self._db.execute(
                        "UPDATE event SET boot = ?, seq = ?, raw = ?, crc = ? WHERE id = ?",
                        (*spool_tables.row(event)[1:], id_),
                    )
            self._later_boots[camera] = new
            self._tops[camera, new] = len(good)
            self._load()
        log.error("%s: the daemon has later events of %s: a new boot begins", self.path, camera)

    def drop(self, camera: str) -> None:
        """Delete the events of ``camera`` that wait, and count them as dropped."""
        with self._using(), self._writing():
            while self._delete("camera = ? AND NOT stored", camera):
                pass

    def adopt(self, path: Path) -> None:
        """Move the events of another spool, which no process has open, into this one."""
        with contextlib.closing(Spool(path, self._first_boot, self._events_max)) as other:
            with self._using(), self._writing():
                spool_tables.copy(
                    self._db,
                    other._db.execute("SELECT * FROM event ORDER BY id"),
                    other._db.execute("SELECT * FROM mark"),
                )
            self._sure = False
        for suffix in ("", "-wal", "-shm"):
            Path(f"{path}{suffix}").unlink(missing_ok=True)

    def statistics(self) -> dict[str, int]:
        """Return counters for the status."""
        with self._using():
            boots = [boot for boots in self._boots.values() for boot in boots.values()]
            return {
                "waiting": sum(boot.waiting for boot in boots),
                "kept": sum(boot.stored for boot in boots),
                "dropped": self.dropped,
                "refused": self.rejects.counts.total(),
                "damaged_events": self.damaged,
                "damaged_files": len(sqlite_file.damaged_files(self.path)),
            }

    def close(self) -> None:
        """Close the file; its events stay for the next time. May be called twice."""
        try:
            with self._using(), self._writing():
                pass
        except sqlite3.ProgrammingError:
            pass  # closed already
        except (sqlite3.Error, StateError) as error:
            log.warning("the spool %s could not be closed properly: %s", self.path, error)
        self._db.close()
        self._lock.close()

    @contextlib.contextmanager
    def _using(self) -> Iterator[None]:
        """Run the block with the spool's lock, and counts that agree with the file."""
        with self._mutex, sqlite_file.damage_noticed(self.path):
            if not self._sure:
                self._load()
            yield

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Run the block in a transaction, which writes the marks that have moved, too."""
        self._sure = False  # after an error the rows may be there or not
        dropped = self.dropped
        try:
            with sqlite_file.transaction(self._db):
                for camera, boot in self._unwritten:
                    if known := self._boots[camera].get(boot):
                        spool_tables.set_row(self._db, "mark", camera, boot, known.have)
                yield
            self._unwritten.clear()
            self._sure = True
        finally:
            if not self._sure:
                self.dropped = dropped

    def _load(self) -> None:
        """Read the marks, but for those that are to be written, and count the events."""
        moved = [
            (camera, boot, self._boots[camera].get(boot, _Boot()).have)
            for camera, boot in self._unwritten
        ]
        self._boots.clear()
        for camera, boot, *known in self._db.execute(_LOAD):
            self._boots[camera][boot] = _Boot(*known)
        for camera, boot, have in moved:
            self._move_mark(camera, boot, have)
        self._sure = True

    def _move_mark(self, camera: str, boot: str, seq: int) -> None:
        known = self._boots[camera].get(boot)
        if known is None or seq == known.have:
            return
        between = self._db.execute(
            "SELECT COUNT(*) FROM event WHERE camera = ? AND boot = ? AND seq > ? AND seq <= ?",
            (camera, boot, *sorted((seq, known.have))),
        ).fetchone()[0]
        newly = between if seq > known.have else -between
        known.waiting -= newly
        known.stored += newly
        known.have = seq
        self._unwritten.add((camera, boot))

    def _number(
        self, events: Sequence[Event]
    ) -> tuple[list[Event], list[tuple[str, codec.Rejected]]]:
        """Return the new events with boot and seq, and (camera, error) of those refused."""
        tops = self._tops.copy()
        numbered: dict[tuple[str, str, int], Event] = {}
        refused = []
        for event in events:
            camera, boot, seq = event.camera, event.boot, event.seq
            if boot and seq is not None:
                if (camera, boot, seq) in numbered or self._holds(camera, boot, seq):
                    self._tops.setdefault((camera, boot), 0)
                    continue
                if seq <= tops.get((camera, boot), 0):
                    boot = None
            if not boot or seq is None:
                boot = self.boot(camera)
                seq = 1 + tops.get((camera, boot), 0)
            event = replace(event, boot=boot, seq=seq, spooled=False)
            try:
                codec.event_from_bytes(codec.to_msgpack(event))  # as the daemon does
            except codec.Rejected as error:
                refused.append((camera, error))
                continue
            tops[camera, boot] = seq
            numbered[camera, boot, seq] = event
        return list(numbered.values()), refused

    def _holds(self, camera: str, boot: str, seq: int) -> bool:
        """Return True if an event with this number is in the file."""
        statement = "SELECT 1 FROM event WHERE camera = ? AND boot = ? AND seq = ?"
        return self._db.execute(statement, (camera, boot, seq)).fetchone() is not None

    def _oldest_boot(self, camera: str) -> str | None:
        """Return the boot of the oldest event of ``camera`` that waits."""
        ages: list[tuple[int, str]] = []
        for boot, known in self._boots[camera].items():
            if known.waiting:
                above = camera, boot, known.have
                row = self._db.execute(f"SELECT id {_WAITING}", above).fetchone()
                if row is None:  # a damaged name
                    known.waiting = 0
                else:
                    ages.append((row[0], boot))
        return min(ages)[1] if ages else None

    def _make_room(self) -> None:
        """Delete surplus events, within a transaction."""
        # Stored events of each camera beyond their limit, with some slack so that this is rare.
        for camera, boots in list(self._boots.items()):
            stored = sum(boot.stored for boot in boots.values())
            if stored > self._kept_max * 9 // 8:
                self._delete("camera = ? AND stored", camera, most=stored - self._kept_max)

        # The oldest ones if there are too many events or bytes.
        if surplus := self._surplus():
            self._delete("stored", most=surplus)
            if surplus := self._surplus():
                self._delete("NOT stored", most=surplus)

    def _surplus(self) -> int:
        """Return the number of events to delete to keep to the limits of events and bytes."""
        held = sum(
            boot.waiting + boot.stored for boots in self._boots.values() for boot in boots.values()
        )
        pages, free, size = (
            self._db.execute(f"PRAGMA {name}").fetchone()[0]
            for name in ("page_count", "freelist_count", "page_size")
        )
        used = (pages - free) * size
        too_large = int(-(-held * (used - self._bytes_max) // used))
        return min(held, max(held - self._events_max, too_large, 0))

    def _delete(self, where: str, *parameters: str, most: int = _DELETED_MAX) -> int:
        """Delete the oldest events that satisfy ``where``, within a transaction; return how many.

        most: how many to delete, at most `_DELETED_MAX`.
        """
        given = (*parameters, min(most, _DELETED_MAX))
        gone = self._db.execute(_DELETE.format(where), given).fetchall()
        for camera, boot, seq in gone:
            known = self._boots[camera][boot]
            known.count(seq, -1)
            if seq > known.have:
                self.dropped += 1
            if not known.waiting and not known.stored and (camera, boot) not in self._tops:
                del self._boots[camera][boot]
                self._db.execute("DELETE FROM mark WHERE camera = ? AND boot = ?", (camera, boot))
        return len(gone)
