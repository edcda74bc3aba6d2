"""Store entries, versions and snapshots in the journal, and publish versions once they are stored.

Nothing is acknowledged, learned or published before it is stored, so a transaction that fails is
retried until it succeeds. One thread stores; the learner's thread passes versions and
snapshots.
"""

from __future__ import annotations

import collections
import logging
import sqlite3
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from camtopod.serve.runtime import Beat, Clock, no_beat
from camtopod.serve.storage.journal import Entry, Journal, Snapshot, StoredVersion

log = logging.getLogger(__name__)


class Learned(NamedTuple):
    """What the learner has made in a step, to be stored in one transaction.

    publish: called once it is stored.
    meta: see `Journal.commit`.
    """

    versions: list[StoredVersion]
    snapshot: Snapshot
    publish: Callable[[], None]
    meta: Mapping[str, str] = {}


class JournalWriter:
    """The storing end of the daemon. Raises `sqlite3.Error`."""

    def __init__(self, journal: Journal, clock: Clock) -> None:
        self._journal = journal
        self._clock = clock
        self._results: collections.deque[Learned] = collections.deque()
        # True if the journal may hold more than its retention, as at a start.
        self._too_much = True
        self.reason = ""
        """Reason why nothing is stored at the moment, or ""."""

    def on_learned(self, result: Learned) -> None:
        """Accept what the learner has made, to be stored and then published. Never blocks."""
        self._results.append(result)

    def store(
        self,
        entries: Sequence[Entry],
        stopping: threading.Event,
        beat: Beat = no_beat,
        meta: Mapping[str, str] | None = None,
    ) -> Sequence[Entry] | None:
        """Commit ``entries``, versions and snapshots of the learner, with retries; then publish.

        meta: see `Journal.commit`.

        Returns the entries that were not in the journal before, which are nearly always all; None
        only if the daemon stops before it succeeds: then nothing may be stored after ``entries``.
        Raises `sqlite_file.Damaged`, where retrying would not help.
        """
        results = [self._results.popleft() for _ in range(len(self._results))]
        versions = [version for result in results for version in result.versions]
        snapshot = results[-1].snapshot if results else None
        meta = dict(meta or {})
        for result in results:
            meta |= result.meta

        # Retry until it succeeds, or until the daemon stops.
        while True:
            try:
                new = self._journal.commit(entries, versions, snapshot, self._clock(), meta)
                break
            except sqlite3.Error as error:
                if not self.reason:
                    log.error("cannot write the journal, so nothing is acknowledged: %s", error)
                self.reason = f"cannot write the journal: {error}"
                beat()  # a restart would not help
                if stopping.wait(0.5):
                    return None
        if self.reason:
            log.info("the journal can be written again")
            self.reason = ""

        # Publish.
        for result in results:
            result.publish()
        self._too_much = self._too_much or bool(results)
        return new

    @property
    def next_number(self) -> int:
        """Number of the entry that is stored next."""
        return len(self._journal) + 1

    def store_command(self, entry: Entry, meta: Mapping[str, str]) -> None:
        """Commit an operator's command at once, or raise `sqlite3.Error`: it is not tried again."""
        self._journal.commit([entry], now=self._clock(), meta=meta)

    def prune(self, cameras: Mapping[str, int]) -> None:
        """After a snapshot, delete some of what is kept for too long, the rest in later calls.

        cameras: see `Journal.forget`.
        """
        if not self._too_much:
            return
        self._too_much = False
        try:
            self._too_much = self._journal.prune(self._clock())
            if cameras:
                self._too_much |= self._journal.forget(cameras)
        except sqlite3.Error as error:
            log.warning("cannot delete old entries of the journal: %s; trying again later", error)
