"""Into the journal: what is ready, versions and snapshots, all in one transaction; what follows
from it comes after.

Nothing is acknowledged, learned or published before it is stored, so a disk that cannot be written
is tried again and again. One thread stores; the learner's hands over versions and snapshots.
"""

from __future__ import annotations

import collections
import contextlib
import logging
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator, Sequence

from camtopod.serve.runtime import Beat, Clock, no_beat
from camtopod.serve.storage.journal import Entry, Journal, Snapshot, StoredVersion
from camtopod.serve.storage.packed_version import Version
from camtopod.serve.storage.sqlite_file import StateError

log = logging.getLogger(__name__)

_RETRY_SECONDS = 0.5
SLOW_SECONDS = 5.0
"""A transaction that takes longer shows in the status; on a slow card one can take seconds."""
BELIEVED_SECONDS = 86_400.0
"""A wall clock that has run evenly for so long is right; until then it makes nothing older by more
than that.
"""
EVEN_SECONDS = 60.0
"""Further apart from the steady clock than before, the wall clock has stepped."""


class Storing:
    """``publish``: called with each version after it is stored. Raises `sqlite3.Error`."""

    def __init__(
        self, journal: Journal, clock: Clock, steady: Clock, publish: Callable[[Version], None]
    ) -> None:
        self._journal, self._clock, self._steady, self._publish = journal, clock, steady, publish
        wall, now = clock(), steady()
        usual = journal.usual_stamp()
        self._believed = (wall if usual is None else usual, now)  # wall and steady clock
        self._even = (
            wall - now,
            now,
        )  # by how much the wall clock is ahead, and since when (steady)
        self._versions: collections.deque[Version] = collections.deque()
        self._snapshots: collections.deque[Snapshot] = collections.deque(maxlen=1)
        self._too_much = False  # whether the journal may have more than is to be kept
        self._failure = ""
        self._began: float | None = None  # the transaction under way (monotonic clock)

    @property
    def reason(self) -> str:
        """The reason why nothing is stored at the moment; "" if all is well. Never waits for the
        disk.
        """
        began = self._began
        seconds = 0.0 if began is None else time.monotonic() - began
        if seconds > SLOW_SECONDS:
            return f"the disk of the journal does not answer: a transaction has taken {seconds:.0f} s so far"
        return self._failure

    def on_version(self, version: Version) -> None:
        """A version from the learner, to be stored and then published. Never blocks."""
        self._versions.append(version)

    def on_snapshot(self, snapshot: Snapshot) -> None:
        """The learner's state, to be stored no earlier than the versions handed over before. Never
        blocks.
        """
        self._snapshots.append(snapshot)

    def store(
        self, entries: Sequence[Entry], stopping: threading.Event, beat: Beat = no_beat
    ) -> bool:
        """Commit, however often it takes, and publish. Gives up, and returns False, only when the
        daemon stops: nothing may then be stored behind ``entries``. Raises `database.Damaged`, as
        trying again would not help.
        """
        snapshot = (
            self._snapshots.popleft() if self._snapshots else None
        )  # before the versions, which it must not pass
        versions = [self._versions.popleft() for _ in range(len(self._versions))]
        stored = [
            StoredVersion(one.head.epoch, one.head.version, one.head.digest, one.content)
            for one in versions
        ]
        while True:
            try:
                with self._timed():
                    self._journal.commit(entries, stored, snapshot, self._clock())
                break
            except sqlite3.Error as error:
                if not self._failure:
                    log.error("cannot write the journal, so nothing is acknowledged: %s", error)
                self._failure = f"cannot write the journal: {error}"
                beat()  # starting again would not help
                if stopping.wait(_RETRY_SECONDS):
                    self._versions.extendleft(
                        reversed(versions)
                    )  # the next snapshot has them in it
                    return False
        if self._failure:
            log.info("the journal can be written again")
            self._failure = ""
        for version in versions:
            self._publish(version)
        self._too_much = self._too_much or snapshot is not None
        return True

    def forget_old(self) -> None:
        """After a snapshot, a part of what the journal need not keep; the rest in the calls to
        come.
        """
        if not self._too_much:
            return
        self._too_much = False
        try:
            with self._timed():
                self._too_much = self._journal.prune(self._believable_time())
        except sqlite3.Error as error:
            log.warning("cannot forget what is old in the journal: %s", error)

    @contextlib.contextmanager
    def _timed(self) -> Iterator[None]:
        """Note how long the block takes, for `reason`."""
        self._began = time.monotonic()
        try:
            yield
        finally:
            self._began = None

    def _believable_time(self) -> float:
        """Unix seconds: the wall clock's unless that is far ahead of what was stored before and of
        the time since. One wrong moment of a clock would otherwise make everything in the journal
        too old to keep.
        """
        wall, now = self._clock(), self._steady()
        apart, since = self._even
        if abs(wall - now - apart) > EVEN_SECONDS:
            self._even = (wall - now, now)
        elif now - since >= BELIEVED_SECONDS:
            self._believed, self._even = (wall, now), (wall - now, since)  # it may drift
        then, at = self._believed
        return min(wall, then + (now - at) + BELIEVED_SECONDS)

    def last_words(self, snapshot: Snapshot | None) -> None:
        """Store what the learner has handed over to the end. Only after both threads have ended."""
        if snapshot is not None:
            self.on_snapshot(snapshot)
        ended = threading.Event()
        ended.set()
        try:
            self.store([], ended)
        except StateError as error:
            log.error("what was learned last is not stored: %s", error)
