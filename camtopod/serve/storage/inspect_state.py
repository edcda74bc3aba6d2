"""Read figures from the databases of a state directory, for diagnosis; writes and locks nothing.

A file is read as of its last checkpoint, that is without the write-ahead log (at most 1 MiB), even
while a program has it open.
"""

from __future__ import annotations

import contextlib
import sqlite3
from pathlib import Path

from camtopod.serve.storage.sqlite_file import StateError

_JOURNAL = {
    "first entry": "SELECT MIN(id) FROM entry",
    "last entry": "SELECT MAX(id) FROM entry",
    "streams": "SELECT COUNT(*) FROM stream",
    "versions": "SELECT COUNT(*) FROM version",
    "newest version": "SELECT version FROM version ORDER BY id DESC LIMIT 1",
    "snapshots": "SELECT COUNT(*) FROM snapshot",
    "newest snapshot at entry": "SELECT MAX(position) FROM snapshot",
}
_SPOOL = {
    "events": "SELECT COUNT(*) FROM event",
    "first event": "SELECT MIN(id) FROM event",
    "last event": "SELECT MAX(id) FROM event",
    "boots acknowledged": "SELECT COUNT(*) FROM acked",
}


def journal(path: Path) -> dict[str, int | None]:
    """Return figures of a daemon's journal, at a cost that barely depends on its size.

    Raises `StateError`.
    """
    return _answers(path, _JOURNAL)


def spool(path: Path) -> dict[str, int | None]:
    """Return figures of a grabber's spool. Raises `StateError`."""
    return _answers(path, _SPOOL)


def _answers(path: Path, questions: dict[str, str]) -> dict[str, int | None]:
    try:
        with contextlib.closing(
            sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
        ) as database:
            return {
                name: (database.execute(sql).fetchone() or [None])[0]
                for name, sql in questions.items()
            }
    except sqlite3.Error as error:
        raise StateError(f"cannot read {path}: {error}") from None
