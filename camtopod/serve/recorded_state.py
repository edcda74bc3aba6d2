"""Make a state directory of a recording, so that a daemon continues from it.

Events become journal entries, as if they had been received, and the learner's state after the last
one becomes the snapshot. If this is interrupted, a daemon can still use the directory: it learns
from the entries itself.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from pathlib import Path

from camtopod import codec
from camtopod.config import KeepSettings
from camtopod.learn.learner import Learner
from camtopod.learn.snapshot import pack
from camtopod.records import Event
from camtopod.serve.runtime import ulid
from camtopod.serve.storage import Entry, Journal, Snapshot, StateError, StoredVersion


class RecordedState:
    """The journal of a new state directory, which is made if missing.

    Raises `StateError` if the directory has a state already or cannot be written.

    now: Unix seconds.
    """

    def __init__(self, directory: Path, keep: KeepSettings, now: float) -> None:
        self._directory = directory
        self._now = now
        self._waiting: list[Entry] = []
        self.epoch = ulid(now)
        """The epoch of the versions."""
        self._journal = Journal(directory, keep)
        if len(self._journal) or self._journal.meta("epoch") is not None:
            self.close()
            raise StateError(
                f"{directory} has a state already: name a new directory, or move that one away"
            )

    def add(self, event: Event) -> None:
        """Store an event that the learner has accepted."""
        self._waiting.append(
            Entry("event", event.camera, event.boot, event.seq, codec.to_json(event))
        )
        if len(self._waiting) >= 10_000:
            self._commit()

    def finish(self, learner: Learner) -> None:
        """Store the state of the learner after the last event, and its newest version."""
        versions = []
        if (newest := learner.topology) is not None:
            content = codec.to_json(newest)
            versions = [StoredVersion(newest.epoch, newest.version, newest.digest, content)]
        self._commit()
        self._commit(versions, Snapshot(len(self._journal), self.epoch, pack(learner.save())))

    def close(self) -> None:
        """Close the journal."""
        self._journal.close()

    def _commit(
        self, versions: Sequence[StoredVersion] = (), snapshot: Snapshot | None = None
    ) -> None:
        """Store what waits, and this."""
        meta = {"epoch": self.epoch}
        try:
            self._journal.commit(self._waiting, versions, snapshot, self._now, meta)
        except sqlite3.Error as error:
            raise StateError(f"cannot write the journal in {self._directory}: {error}") from None
        self._waiting = []
