"""Execute an operator's command in a state directory that no daemon uses.

The command becomes an entry of the journal, as it would in a daemon; the next daemon that starts
there carries it out in its learner.
"""

from __future__ import annotations

import contextlib
import sqlite3
from pathlib import Path

from camtopod import codec
from camtopod.admin import Command, Reset
from camtopod.config import KeepSettings
from camtopod.records import Topology
from camtopod.serve.ingest import Names, known_site, read_names
from camtopod.serve.learner_process import recent_events
from camtopod.serve.runtime import ulid
from camtopod.serve.storage import NAMES_KEY, Journal, StateError, lock_reason


def carry_out_offline(directory: Path, command: Command, keep: KeepSettings, now: float) -> str:
    """Store a command in the journal of a state directory; return its effect, in words.

    keep: retention of the journal.
    now: Unix seconds.

    Raises `StateError`, and `CommandRefused`.
    """
    path = directory / "journal.db"
    if not path.exists():
        raise StateError(f"there is no state of a daemon in {directory}: name it with --state")
    if lock_reason(path):
        raise StateError(
            f"a daemon uses {directory}: give the command to it over the bus (leave --state out),"
            " or stop it first"
        )
    with contextlib.closing(Journal(directory, keep)) as journal:
        try:
            return _carry_out(journal, command, now)
        except (sqlite3.Error, codec.Rejected) as error:
            raise StateError(f"cannot change the journal in {directory}: {error}") from None


def _carry_out(journal: Journal, command: Command, now: float) -> str:
    """Store a command; return its effect, in words. Raises `sqlite3.Error` and `codec.Rejected`."""
    # The site as the journal knows it.
    names = Names(read_names(journal.meta(NAMES_KEY)), lambda: now)
    content = journal.newest_version()
    topology = None if content is None else codec.read(Topology, content)
    received = {event.camera for event in recent_events(journal)}
    heard = {camera for camera, _ in journal.numbers()[0]}
    site = known_site(topology, received, heard, names.state.since)

    # Store the command, and with it the epoch that a reset begins.
    meta = {}
    if isinstance(command, Reset):
        ended = journal.meta("epoch") or ""
        epoch = ulid(now, after=max(ended, journal.meta("epoch before") or ""))
        command, meta = Reset(now, ended, epoch), {"epoch": epoch}
    entry, said = names.carry_out(command, site)
    assert entry.names is not None
    journal.commit([entry.entry], now=now, meta={**meta, NAMES_KEY: entry.names})
    return said
