"""Durable state of a program: SQLite files that survive power cuts, and the daemon's journal.

Read from the bottom up. `sqlite_file` opens, checks and sets aside databases.
`journal` stores entries, versions and snapshots in one of them; `journal_schema` has its tables,
`witness` notices a journal that was restored from an older copy, `commands` are those of an
operator as entries. `journal_writer` is the daemon's storing thread.
"""

from camtopod.serve.storage import sqlite_file as sqlite_file
from camtopod.serve.storage.commands import (
    command_entry as command_entry,
    read_command as read_command,
)
from camtopod.serve.storage.journal import (
    STREAMS_KEPT_MAX as STREAMS_KEPT_MAX,
    Entry as Entry,
    Journal as Journal,
    Snapshot as Snapshot,
    StoredVersion as StoredVersion,
    Stream as Stream,
    highest_numbers as highest_numbers,
)
from camtopod.serve.storage.journal_schema import NAMES_KEY as NAMES_KEY
from camtopod.serve.storage.journal_writer import JournalWriter as JournalWriter, Learned as Learned
from camtopod.serve.storage.sqlite_file import (
    InUse as InUse,
    StateError as StateError,
    lock_reason as lock_reason,
)
