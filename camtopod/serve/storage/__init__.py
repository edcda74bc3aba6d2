"""Durable state of a program: SQLite files that survive power cuts, and the daemon's journal.

Read from the bottom up. `sqlite_file` opens, checks and sets aside databases.
`journal` stores entries, versions and snapshots in one of them; `journal_schema` has its tables,
`witness` notices a journal that was restored from an older copy, `corrections` are entries
that revise what was learned, and `packed_version` is a topology on its way into the journal.
`journal_writer` is the daemon's storing thread.
"""

from __future__ import annotations

from camtopod.serve.storage import sqlite_file
from camtopod.serve.storage.corrections import (
    Rewind,
    command_entry,
    epoch_after,
    read_command,
    read_reset,
    read_rewind,
    reset_entry,
    rewind,
)
from camtopod.serve.storage.journal import Entry, Journal, Snapshot, StoredVersion
from camtopod.serve.storage.journal_schema import NAMES_KEY
from camtopod.serve.storage.journal_writer import JournalWriter
from camtopod.serve.storage.packed_version import CurrentVersion, Version, head_of
from camtopod.serve.storage.sqlite_file import StateError, lock_reason

__all__ = [
    "NAMES_KEY",
    "CurrentVersion",
    "Entry",
    "Journal",
    "JournalWriter",
    "Rewind",
    "Snapshot",
    "StateError",
    "StoredVersion",
    "Version",
    "command_entry",
    "epoch_after",
    "head_of",
    "lock_reason",
    "read_command",
    "read_reset",
    "read_rewind",
    "reset_entry",
    "rewind",
    "sqlite_file",
]
