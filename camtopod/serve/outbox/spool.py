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
import math
import sqlite3
import threading
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

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
_DEFAULT = Limits()

_LOAD = """
SELECT event.camera, event.boot, COALESCE(have, 0)
FROM event LEFT JOIN mark USING (camera, boot) GROUP BY camera, boot ORDER BY MIN(id)
"""
_BOOT = "event WHERE camera = ? AND boot = ?"
_WAITING = f"{_BOOT} AND seq > ?"
_STORED = "SELECT id FROM event JOIN mark USING (camera, boot) WHERE seq <= have"


class Spool:
    """A spool file, for one publishing process. Thread-safe.

    boot: name of the boot that begins.
    events_max: maximum number of events in the file.
    bytes_max: largest size of the file, in bytes.
    kept_max: maximum number of stored events of one camera that are kept.

    A hundredth more may be in the file. When it is full the oldest stored events are deleted, then
    the oldest that wait, counted in `dropped`. A damaged file is set aside, and its readable events
    are copied to the new one. Raises `StateError` on opening, and `sqlite_file.Damaged` as soon as
    damage shows; methods that read or write the file raise `sqlite3.Error`.
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
        self.damage_count = 0
        """Damaged events that were found, since the start."""
        self.rejects = Rejects()
        """Events that were refused, as the daemon would reject them."""
        self._events_max = events_max
        self._bytes_max = bytes_max
        self._kept_max = kept_max
        self._first_boot = boot
        self._later_boots: dict[str, str] = {}
        # Camera -> boot, oldest first -> number up to which the daemon has stored it.
        self._marks: defaultdict[str, dict[str, int]] = defaultdict(dict)
        self._unwritten: set[tuple[str, str]] = set()  # (camera, boot) of marks that have moved
        # (camera, boot) of which this process was given events -> the highest number of them.
        self._tops: dict[tuple[str, str], int] = {}
        # (camera, boot) -> a number that none of the events in the file is above.
        self._ceilings: dict[tuple[str, str], int] = {}
        # (camera, boot) -> number of events that wait, where it is known.
        self._counts: dict[tuple[str, str], int] = {}
        self._additions = math.inf  # events since the limits were looked at
        self._mutex = threading.Lock()
        self._lock = sqlite_file.Lock(path.with_suffix(".lock"))

        # Open the file; release everything after an error.
        with contextlib.ExitStack() as undo:
            undo.callback(self._lock.close)
            try:
                self._db, _ = sqlite_file.connect_or_recreate(
                    path, spool_tables.SCHEMA, spool_tables.FORMAT, needed_tables=("meta", "mark")
                )
                undo.callback(self._db.close)
                with self._using():
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
        with self._using():
            batch, rows, refusals = self._number(events)
            self._counts.clear()  # after an error, too
            with self._writing():
                self._db.executemany(spool_tables.INSERT, rows)
                drops = self._make_room(len(rows))
            for camera, boot, seq, *_ in rows:
                self._marks[camera].setdefault(boot, 0)
                self._tops[camera, boot] = seq

        # Report the events that were left out.
        for camera, error in refusals:
            self.rejects.add(error.reason, f"event of {camera}", str(error))
        if drops and not self.dropped:
            log.error("the spool %s is full: its oldest events are dropped", self.path)
        self.dropped += drops
        return batch

    def boot(self, camera: str) -> str:
        """Return the boot in which this process numbers the events of ``camera``."""
        return self._later_boots.get(camera, self._first_boot)

    def boots(self, camera: str) -> list[str]:
        """Return the boots of ``camera`` in the spool, oldest first; the one it numbers is last.

        At most `BOOTS_MAX`, the newest.
        """
        with self._using():
            names = [name for name in self._marks[camera] if name != self.boot(camera)]
            return [*names[1 - BOOTS_MAX :], self.boot(camera)]

    def cameras(self) -> list[str]:
        """Return the cameras with events in the spool."""
        with self._using():
            return [camera for camera, boots in self._marks.items() if boots]

    def mark(self, camera: str, boot: str) -> int:
        """Return the number up to which the daemon has stored a boot, as far as is known."""
        with self._using():
            return self._marks[camera].get(boot, 0)

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
            total = 0
            for name in self._marks if camera is None else [camera]:
                for boot, have in self._marks[name].items():
                    if own and (name, boot) not in self._tops:
                        continue
                    if (name, boot) not in self._counts:
                        self._counts[name, boot] = self._count(_WAITING, name, boot, have)
                    total += self._counts[name, boot]
            return total

    def next_batch(self, camera: str, limit: int) -> tuple[str, list[tuple[int, bytes]]] | None:
        """Return boot and (seq, bytes) of the events of ``camera`` to be sent next, by rising seq.

        They are at most ``limit`` and `BATCH_BYTES_MAX`, of the oldest boot of which events wait. A
        damaged event is logged and deleted. None if no event waits.
        """
        with self._using():
            for boot, have in self._marks[camera].items():
                events: list[tuple[int, bytes]] = []
                bad_rows = []
                size = 0
                statement = f"SELECT id, seq, raw, crc FROM {_WAITING} ORDER BY seq"
                for id_, seq, raw, crc in self._db.execute(statement, (camera, boot, have)):
                    if crc != sqlite_file.crc(camera, boot, seq, raw):
                        bad_rows.append((id_,))
                        continue
                    size += len(raw)
                    if len(events) == limit or (events and size > BATCH_BYTES_MAX):
                        break
                    events.append((seq, raw))

                if bad_rows:
                    self._counts.clear()
                    with sqlite_file.transaction(self._db):
                        self._db.executemany("DELETE FROM event WHERE id = ?", bad_rows)
                    self.damage_count += len(bad_rows)
                    log.error("%s: %d events of %s are damaged", self.path, len(bad_rows), camera)
                if events:
                    return boot, events
            return None

    def have(self, camera: str, boot: str, seq: int) -> None:
        """Note that the daemon has stored a boot up to ``seq``, and nothing beyond it.

        This is written with the next events or on closing: after a kill the daemon says it again.
        """
        with self._using():
            before = self._marks[camera].get(boot, seq)
            if before == seq:
                return
            if before < seq and (camera, boot) in self._counts:
                passed = self._count(f"{_WAITING} AND seq <= ?", camera, boot, before, seq)
                self._counts[camera, boot] -= passed
            else:
                self._counts.pop((camera, boot), None)
            self._marks[camera][boot] = seq
            self._unwritten.add((camera, boot))

    def begin_boot(self, camera: str, new: str) -> None:
        """Begin the boot ``new`` for ``camera``, and number what waits of the present one in it.

        Its name must never have been used: a machine that is set back again would repeat it.
        """
        with self._using():
            old = self.boot(camera)
            above = camera, old, self._marks[camera].get(old, 0)
            rows = self._db.execute(f"SELECT * FROM {_WAITING} ORDER BY seq", above).fetchall()
            good = [row for row in rows if sqlite_file.sound(row[1:])]
            self._counts.clear()
            with sqlite_file.transaction(self._db):
                for seq, (id_, *_, raw, _) in enumerate(good, 1):
                    event = replace(codec.event_from_bytes(raw), boot=new, seq=seq)
                    self._db.execute(
                        "UPDATE event SET boot = ?, seq = ?, raw = ?, crc = ? WHERE id = ?",
                        (*spool_tables.row(event)[1:], id_),
                    )
            self._later_boots[camera] = new
            self._tops[camera, new] = len(good)
            self._marks[camera][new] = 0
        log.error("%s: the daemon has later events of %s: a new boot begins", self.path, camera)

    def drop(self, camera: str) -> None:
        """Delete the events of ``camera`` that wait, and count them as dropped."""
        with self._using():
            self._counts.clear()
            for boot, have in self._marks[camera].items():
                parameters = (camera, boot, have)
                self.dropped += self._db.execute(f"DELETE FROM {_WAITING}", parameters).rowcount

    def adopt(self, path: Path) -> None:
        """Move the events of another spool, which no process has open, into this one."""
        source = Spool(path, self._first_boot, self._events_max)
        with contextlib.closing(source), self._using():
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
        with self._using():
            return {
                "waiting": backlog,
                "kept": self._count("event") - backlog,
                "dropped": self.dropped,
                "refused": self.rejects.counts.total(),
                "damaged_events": self.damage_count,
                "damaged_files": len(sqlite_file.damaged_files(self.path)),
            }

    def close(self) -> None:
        """Close the file; its events stay for the next time. May be called twice."""
        with contextlib.suppress(sqlite3.Error, StateError), self._using(), self._writing():
            pass
        self._db.close()
        self._lock.close()

    @contextlib.contextmanager
    def _using(self) -> Iterator[None]:
        with self._mutex, sqlite_file.damage_noticed(self.path):
            yield

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Run the block in a transaction, which writes the marks that have moved, too."""
        with sqlite_file.transaction(self._db):
            for camera, boot in self._unwritten:
                row = (camera, boot, self._marks[camera][boot])
                self._db.execute(
                    "INSERT OR REPLACE INTO mark VALUES (?, ?, ?, ?)", (*row, sqlite_file.crc(*row))
                )
            yield
        self._unwritten.clear()

    def _load(self) -> None:
        """Read which boots there are, and their marks."""
        self._marks.clear()
        self._counts.clear()
        self._ceilings.clear()
        for camera, boot, have in self._db.execute(_LOAD):
            self._marks[camera][boot] = have

    def _number(
        self, events: Sequence[Event]
    ) -> tuple[list[Event], list[spool_tables.EventRow], list[tuple[str, codec.Rejected]]]:
        """Return the new events with boot and seq, their rows, and (camera, error) of bad ones."""
        tops = self._tops.copy()
        batch: list[Event] = []
        rows: list[spool_tables.EventRow] = []
        numbers: set[tuple[str, str, int]] = set()
        refusals = []
        for event in events:
            camera, boot, seq = event.camera, event.boot, event.seq
            if boot and seq is not None:
                if seq <= self._ceiling(camera, boot):
                    count = self._count(f"{_BOOT} AND seq = ?", camera, boot, seq)
                    if count or (camera, boot, seq) in numbers:
                        self._tops.setdefault((camera, boot), 0)
                        continue
                if seq <= tops.get((camera, boot), 0):
                    boot = None
            if not boot or seq is None:
                boot = self.boot(camera)
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

    def _count(self, rows: str, *parameters: str | int) -> int:
        """Return the number of these rows."""
        return int(self._db.execute(f"SELECT COUNT(*) FROM {rows}", parameters).fetchone()[0])

    def _make_room(self, additions: int) -> int:
        """Delete surplus events, within a transaction; return how many of them waited.

        additions: number of events just added. The limits are looked at now and then.
        """
        self._additions += additions
        if self._additions < min(self._events_max, 10 * self._kept_max) // 100:
            return 0

        # Stored events of each camera beyond their limit, with some slack so that this is rare.
        large = "SELECT camera FROM event GROUP BY camera HAVING COUNT(*) > ?"
        for (camera,) in self._db.execute(large, (self._kept_max * 9 // 8,)).fetchall():
            self._db.execute(
                f"DELETE FROM event WHERE id IN"
                f" ({_STORED} AND camera = ? ORDER BY id DESC LIMIT -1 OFFSET ?)",
                (camera, self._kept_max),
            )
        self._db.execute(
            "DELETE FROM mark WHERE NOT EXISTS (SELECT 1 FROM event"
            " WHERE event.camera = mark.camera AND event.boot = mark.boot)"
        )
        self._additions = 0

        # The oldest ones if there are too many events or bytes.
        count = self._count("event")
        size = sqlite_file.used_bytes(self._db)
        too_large = -(-count * (size - self._bytes_max) // size)
        surplus = min(count, max(count - self._events_max, too_large))
        if surplus <= 0:
            return 0
        delete = "DELETE FROM event WHERE id IN ({} ORDER BY id LIMIT ?)"
        deletions = self._db.execute(delete.format(_STORED), (surplus,)).rowcount
        parameters = (surplus - deletions,)
        return self._db.execute(delete.format("SELECT id FROM event"), parameters).rowcount
