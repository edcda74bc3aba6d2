"""A journal and a spool that are written in steps, and what is then in them, for storage faults."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Protocol

from camtopod.config.settings import KeepSettings
from camtopod.records import Event
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage.journal import Entry, Journal, Snapshot, StoredVersion

KEEP = KeepSettings(journal_bytes_max=150_000)
"""Retention settings, small so that old data is deleted."""
EPOCH = "e1"
PRUNE_EVERY, PRUNE_AT = 40, 39
"""Every so many steps a journal deletes old data, in step `PRUNE_AT` of each round."""
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

    def close(self) -> None: ...


Open = Callable[[Path], Written]
"""Opens a file in a directory."""


class WrittenJournal:
    """A journal of entries, with versions, snapshots and retention now and then."""

    def __init__(self, directory: Path) -> None:
        self.journal = Journal(directory, KEEP)
        self.damaged = self.journal.set_aside is not None or self.journal.missing > 0

    def step(self, number: int) -> None:
        if number % PRUNE_EVERY == PRUNE_AT:
            self.journal.prune(now=float(number))
        else:
            self.journal.commit(*step_of(number, len(self.journal)), now=float(number))

    def state(self) -> State:
        entries = tuple(self.journal.entries())
        assert all(entry is not None for _, entry in entries), "damaged"
        versions = self.journal.versions(EPOCH)
        contents = tuple((n, versions[n], self.journal.version(EPOCH, n)) for n in versions)
        numbers = self.journal.numbers()
        snapshots = tuple(self.journal.snapshots())
        return entries, contents, snapshots, tuple(sorted(numbers.items())), len(self.journal)

    def close(self) -> None:
        self.journal.close()


def step_of(number: int, last: int) -> tuple[list[Entry], list[StoredVersion], Snapshot | None]:
    """Return the content of a step of a journal with ``last`` entries."""
    chance = random.Random(number)
    camera = chance.choice(CAMERAS)
    seqs = range(10 * number, 10 * number + chance.randint(1, 6))
    entries = [Entry("event", camera, "b1", seq, chance.randbytes(60)) for seq in seqs]
    versions, snapshot = [], None
    if number % 7 == 3:
        versions = [StoredVersion(EPOCH, number, f"sha256:{number}", chance.randbytes(900))]
    if number % 20 == 11:
        snapshot = Snapshot(last, EPOCH, chance.randbytes(6000))
    return entries, versions, snapshot


class WrittenSpool:
    """A spool with events of some cameras, of which the daemon has most at once."""

    def __init__(self, directory: Path) -> None:
        boot = f"boot-{time.monotonic_ns()}" if (directory / "spool.db").exists() else "boot-0"
        self.spool = Spool(directory / "spool.db", boot, 150, kept_max=40)
        self.damaged = bool(self.spool.statistics()["damaged_files"])
        self._have: dict[tuple[str, str], int] = {}

    def step(self, number: int) -> None:
        for (camera, boot), seq in self._have.items():  # after an error the daemon says it again
            self.spool.queue().have(camera, boot, seq)
        last = self.spool.append(events_of(number))[-1]
        if number % 5 != 0:
            self._have[last.camera, str(last.boot)] = last.seq or 0

    def state(self) -> State:
        return tuple(self.spool._db.execute("SELECT * FROM event ORDER BY id"))

    def close(self) -> None:
        self.spool.close()


def events_of(number: int) -> list[Event]:
    """Return the events of a step of the spool, all of one camera."""
    chance = random.Random(number)
    camera = chance.choice(CAMERAS)
    times = [10.0 * number + n for n in range(chance.randint(1, 6))]
    return [Event(camera, "entry", t, track="x" * 40) for t in times]


FILES: dict[str, Open] = {"journal": WrittenJournal, "spool": WrittenSpool}
"""Written files by name."""
