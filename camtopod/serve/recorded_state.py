"""Make a state directory of a recording, so that a daemon continues from it.

Events become journal entries, as if they had been received, and the learner's state after the last
one becomes the snapshot. If this is interrupted, a daemon can still use the directory: it learns
from the entries itself.
"""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

from camtopod import codec
from camtopod.config import KeepSettings
from camtopod.learn.learner import Learner
from camtopod.learn.snapshot import pack
from camtopod.records import Event
from camtopod.serve.runtime import ulid
from camtopod.serve.storage import Entry, Journal, Snapshot, StateError, StoredVersion


class RecordedState:
    """The journal of a new state directory, as a context manager; the directory is made if missing.

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
        with contextlib.ExitStack() as undo:
            undo.callback(self._journal.close)
            if len(self._journal) or self._journal.meta("epoch") is not None:
                raise StateError(
                    f"{directory} has a state already: name a new directory, or move that one away"
                )
            with self._errors_named():
                self._journal.set_meta("epoch", self.epoch)
            undo.pop_all()

    def __enter__(self) -> RecordedState:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self._journal.close()

    def add(self, event: Event) -> None:
        """Store an event that the learner has accepted."""
        self._waiting.append(
            Entry("event", event.camera, event.boot, event.seq, codec.to_json(event))
        )
        if len(self._waiting) >= 10_000:
            self._commit()

    def finish(self, learner: Learner) -> None:
        """Store the state of the learner after the last event, and its newest version."""
        topology = learner.topology
        versions = []
        if topology is not None:
            versions = [
                StoredVersion(
                    topology.epoch, topology.version, topology.digest, codec.to_json(topology)
                )
            ]
        self._commit()
        snapshot = Snapshot(len(self._journal), self.epoch, pack(learner.save()))
        with self._errors_named():
            self._journal.commit([], versions, snapshot, self._now)

    def _commit(self) -> None:
        with self._errors_named():
            self._journal.commit(self._waiting, now=self._now)
        self._waiting = []

    @contextlib.contextmanager
    def _errors_named(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise StateError(f"cannot write the journal in {self._directory}: {error}") from None
