"""What is in the databases of a state directory, for somebody who looks for a fault; nothing is
written or locked.

A file is read as it stood at its last checkpoint, at most a mebibyte of log ago, even while a
program has it open.
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
    """Counts of a daemon's journal; none of them takes longer for a larger one. Raises
    `StateError`.
    """
    return _answers(path, _JOURNAL)


def spool(path: Path) -> dict[str, int | None]:
    """Counts of a grabber's spool. Raises `StateError`."""
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
