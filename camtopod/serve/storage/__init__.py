"""storage"""

from __future__ import annotations

from camtopod.serve.storage import inspect_state, sqlite_file
from camtopod.serve.storage.corrections import (
    Rewind,
    corrections,
    leave_out,
    offender,
    read_rewind,
    rewind,
)
from camtopod.serve.storage.journal import Entry, Journal, Snapshot, StoredVersion
from camtopod.serve.storage.journal_writer import Storing
from camtopod.serve.storage.packed_version import Newest, Version, for_prediction, head_of
from camtopod.serve.storage.sqlite_file import StateError, held_by

__all__ = [
    "Entry",
    "Journal",
    "Newest",
    "Rewind",
    "Snapshot",
    "StateError",
    "StoredVersion",
    "Storing",
    "Version",
    "corrections",
    "for_prediction",
    "head_of",
    "held_by",
    "inspect_state",
    "leave_out",
    "offender",
    "read_rewind",
    "rewind",
    "sqlite_file",
]
