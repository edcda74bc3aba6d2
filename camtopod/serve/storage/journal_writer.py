"""Store entries, versions and snapshots in the journal, and publish versions once they are stored.

Nothing is acknowledged, learned or published before it is stored, so a transaction that fails is
retried until it succeeds. One thread stores; the learner's thread passes versions and
snapshots.
"""

from __future__ import annotations

import collections
import contextlib
import logging
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

from camtopod.records import Topology
from camtopod.serve.runtime import Beat, Clock, no_beat
from camtopod.serve.storage.journal import (
    Entry,
    Journal,
    Snapshot,
    StoredVersion,
    Stream,
    highest_numbers,
)
from camtopod.serve.storage.sqlite_file import StateError

log = logging.getLogger(__name__)

SLOW_SECONDS = 5.0
"""A transaction that takes longer than this (seconds) shows in the status.

On a slow memory card one can take several seconds.
"""


class Version(NamedTuple):
    """A new version on its way to the journal and then to the bus.

    content, packed: the version as JSON and as MessagePack.
    delta: the changes since the last version as MessagePack; None for the first.
    """

    topology: Topology
    content: bytes
    packed: bytes
    delta: bytes | None


class JournalWriter:
    """The storing end of the daemon. ``publish`` is called with each version after it is stored.

    Raises `sqlite3.Error`.
    """

    def __init__(self, journal: Journal, clock: Clock, publish: Callable[[Version], None]) -> None:
        self._journal = journal
        self._clock = clock
        self._publish = publish
        self._versions: collections.deque[Version] = collections.deque()
        self._snapshots: collections.deque[Snapshot] = collections.deque(maxlen=1)
        # True if the journal may hold more than its retention.
        self._too_much = False
        self._failure = ""
        # Start of the transaction under way, on the monotonic clock.
        self._began: float | None = None

    @property
    def reason(self) -> str:
        """Reason why nothing is stored at the moment, or "". Never waits for the disk."""
        began = self._began
        seconds = 0.0 if began is None else time.monotonic() - began
        if seconds > SLOW_SECONDS:
            return (
                "the disk of the journal does not answer: "
                f"a transaction has taken {seconds:.0f} s so far"
            )
        return self._failure

    def on_version(self, version: Version) -> None:
        """Accept a version from the learner, to be stored and then published. Never blocks."""
        self._versions.append(version)

    def on_snapshot(self, snapshot: Snapshot) -> None:
        """Accept the learner's state, to be stored together with or after the versions before it.

        Never blocks.
        """
        self._snapshots.append(snapshot)

    def store(
        self,
        entries: Sequence[Entry],
        stopping: threading.Event,
        beat: Beat = no_beat,
        meta: Mapping[str, str] | None = None,
        forgotten: Sequence[Stream] = (),
    ) -> Sequence[Entry] | None:
        """Commit ``entries``, versions and snapshots of the learner, with retries; then publish.

        meta, forgotten: see `Journal.commit`.

        Returns the entries that were not in the journal before, which are nearly always all; None
        only if the daemon stops before it succeeds: then nothing may be stored after ``entries``.
        Raises `sqlite_file.Damaged`, where retrying would not help.
        """
        # Take the snapshot before the versions: it must not be stored before any of them.
        snapshot = self._snapshots.popleft() if self._snapshots else None
        versions = [self._versions.popleft() for _ in range(len(self._versions))]
        stored = [
            StoredVersion(
                one.topology.epoch, one.topology.version, one.topology.digest, one.content
            )
            for one in versions
        ]

        # Retry until it succeeds, or until the daemon stops.
        new: Sequence[Entry] | None = None
        while True:
            try:
                with self._timed():
                    if new is None:
                        new = self._journal.new_entries(entries)
                        numbers = highest_numbers(entries) if len(new) < len(entries) else {}
                    self._journal.commit(
                        new, stored, snapshot, self._clock(), meta, numbers, forgotten
                    )
                break
            except sqlite3.Error as error:
                if not self._failure:
                    log.error("cannot write the journal, so nothing is acknowledged: %s", error)
                self._failure = f"cannot write the journal: {error}"
                if isinstance(error, sqlite3.IntegrityError):
                    new = None  # some entries are there already
                    self._journal.look_again()
                beat()  # a restart would not help
                if stopping.wait(0.5):
                    # The next snapshot includes these versions, so they have to come before it.
                    self._versions.extendleft(reversed(versions))
                    return None
        if self._failure:
            log.info("the journal can be written again")
            self._failure = ""

        # Publish.
        for version in versions:
            self._publish(version)
        self._too_much = self._too_much or snapshot is not None
        return new

    def prune(self) -> None:
        """After a snapshot, delete some of what exceeds the retention, the rest in later calls."""
        if not self._too_much:
            return
        self._too_much = False
        try:
            with self._timed():
                self._too_much = self._journal.prune(self._clock())
        except sqlite3.Error as error:
            log.warning("cannot delete old entries of the journal: %s; trying again later", error)

    @contextlib.contextmanager
    def _timed(self) -> Iterator[None]:
        """Note that a transaction is under way while the block runs, for `reason`."""
        self._began = time.monotonic()
        try:
            yield
        finally:
            self._began = None

    def store_remaining(self, snapshot: Snapshot | None) -> None:
        """Store the learner's last versions and snapshots, after both threads have ended."""
        if snapshot is not None:
            self.on_snapshot(snapshot)
        ended = threading.Event()
        ended.set()
        try:
            self.store([], ended)
        except StateError as error:
            log.error("the last versions and snapshot could not be stored: %s", error)
