"""A journal and a spool that are written in steps, and what is then in them, for storage faults."""

from __future__ import annotations

import collections
import random
import time
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Protocol

from camtopod import codec
from camtopod.config.settings import KeepSettings
from camtopod.records import Event
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage.journal import Entry, Journal, Snapshot, StoredVersion
from camtopod.serve.storage.sqlite_file import damaged_files

KEEP = KeepSettings(journal_bytes_max=150_000)
"""Retention settings, small so that old data is deleted."""
EPOCH = "e1"
PRUNE_EVERY, PRUNE_AT = 40, 39
"""Every so many steps one deletes old data, the step `PRUNE_AT` of each round."""
CAMERAS = ("lobby", "hall", "yard")
State = Hashable
"""Comparable content of a file."""


class Written(Protocol):
    """A file written in numbered steps, each a transaction; content depends on its number alone."""

    damaged: bool
    """True if something was set aside on opening."""

    def step(self, number: int) -> None:
        """Write a step, which is durable afterwards.

        Raises `sqlite3.Error`; the step may then be repeated.
        """

    def state(self) -> State:
        """Return the content, as far as it must survive."""

    def last(self) -> int:
        """Return the newest step that is stored."""

    def missing(self, start: int, stop: int) -> list[int]:
        """Return the steps in this range that are incomplete, and not deleted by retention."""

    def close(self) -> None: ...


Open = Callable[[Path], Written]
"""Opens a file in a directory."""


class WrittenJournal:
    """A journal of entries, with versions, snapshots and retention now and then."""

    def __init__(self, directory: Path) -> None:
        self.journal = Journal(directory, KEEP)
        log_damaged = bool(damaged_files(directory / "journal.db-wal"))
        self.damaged = log_damaged or self.journal.set_aside is not None or self.journal.missing > 0

    def step(self, number: int) -> None:
        if number % PRUNE_EVERY == PRUNE_AT:
            self.journal.prune(now=float(number))
        else:
            self.journal.commit(*step_of(number, len(self.journal)), now=float(number))

    def state(self) -> State:
        entries = tuple(self.journal.entries())
        assert all(entry is not None for _, entry in entries), "damaged"
        versions = self.journal.versions(EPOCH)
        contents = tuple(
            (n, digest, self.journal.version(EPOCH, n)) for n, digest in versions.items()
        )
        numbers, unknown = self.journal.numbers()
        assert not unknown, "damaged"
        snapshots = tuple(self.journal.snapshots())
        return entries, contents, snapshots, tuple(sorted(numbers.items())), len(self.journal)

    def last(self) -> int:
        newest = self.journal._db.execute("SELECT COALESCE(MAX(seq), 0) FROM entry").fetchone()[0]
        newest = int(newest) // 10
        return newest + ((newest + 1) % PRUNE_EVERY == PRUNE_AT)

    def missing(self, start: int, stop: int) -> list[int]:
        raws = collections.defaultdict(list)
        for _, entry in self.journal.entries():
            assert entry is not None
            raws[(entry.seq or 0) // 10].append(entry.raw)
        versions = self.journal.versions(EPOCH)
        oldest = min(versions, default=0)
        gone = []
        for number in range(max(start, min(raws, default=start) + 1), stop):
            entries, wanted, _ = step_of(number, 0)
            whole = raws[number] == [entry.raw for entry in entries]
            whole = whole and all(one.version in versions or one.version < oldest for one in wanted)
            if number % PRUNE_EVERY != PRUNE_AT and not whole:
                gone.append(number)
        return gone

    def close(self) -> None:
        self.journal.close()


def step_of(number: int, last: int) -> tuple[list[Entry], list[StoredVersion], Snapshot | None]:
    """Return the content of a step of a journal with ``last`` entries."""
    chance = random.Random(number)
    camera = chance.choice(CAMERAS)
    entries = [
        Entry("event", camera, "b1", 10 * number + n, chance.randbytes(60))
        for n in range(chance.randint(1, 6))
    ]
    versions = (
        [StoredVersion(EPOCH, number, f"sha256:{number}", chance.randbytes(900))]
        if number % 7 == 3
        else []
    )
    snapshot = Snapshot(last, EPOCH, chance.randbytes(6000)) if number % 20 == 11 else None
    return entries, versions, snapshot


class WrittenSpool:
    """A spool with events of some cameras, of which the daemon has most at once."""

    events_max, kept_max = 150, 40

    def __init__(self, directory: Path) -> None:
        boot = f"boot-{time.monotonic_ns()}" if (directory / "spool.db").exists() else "boot-0"
        self.spool = Spool(directory / "spool.db", boot, self.events_max, kept_max=self.kept_max)
        self.damaged = bool(self.spool.statistics()["damaged_files"])
        self._have: dict[tuple[str, str], int] = {}

    def step(self, number: int) -> None:
        for (camera, boot), seq in self._have.items():  # after an error the daemon says it again
            self.spool.have(camera, boot, seq)
        last = self.spool.append(events_of(number))[-1]
        if number % 5 != 0:
            self._have[last.camera, str(last.boot)] = last.seq or 0

    def state(self) -> State:
        return tuple(self.spool._db.execute("SELECT * FROM event ORDER BY id"))

    def last(self) -> int:
        row = self.spool._db.execute("SELECT raw FROM event ORDER BY id DESC LIMIT 1").fetchone()
        return 0 if row is None else int(codec.event_from_msgpack(row[0]).t) // 10

    def missing(self, start: int, stop: int) -> list[int]:
        most = min(self.events_max - 100, 2000)
        rows = self.spool._db.execute("SELECT raw FROM event ORDER BY id DESC LIMIT ?", (most,))
        times = {codec.event_from_msgpack(raw).t for (raw,) in rows}
        if len(times) >= most:
            start = max(start, int(min(times)) // 10 + 1)
        return [n for n in range(start, stop) if not {e.t for e in events_of(n)} <= times]

    def close(self) -> None:
        self.spool.close()


def events_of(number: int) -> list[Event]:
    """Return the events of a step of the spool, all of one camera."""
    chance = random.Random(number)
    camera = chance.choice(CAMERAS)
    return [
        Event(camera, "entry", 10.0 * number + n, track="x" * 40)
        for n in range(chance.randint(1, 6))
    ]


FILES: dict[str, Open] = {"journal": WrittenJournal, "spool": WrittenSpool}
"""Written files by name."""
