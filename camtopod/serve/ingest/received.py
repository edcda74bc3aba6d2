"""What the daemon receives, on its way into the journal."""

from __future__ import annotations

import threading

from msgspec import Struct

from camtopod.admin import Command, Reset, Rewind
from camtopod.records import Event
from camtopod.serve.storage import Entry, command_entry


class Received(Struct, frozen=True, gc=False):
    """An entry on its way into the journal, and its effect on the learner.

    event: the event to be learned; None if it is only stored.
    advance: event time that advances without an event, Unix seconds.
    command: a command.
    meta: what is stored under other keys in the same transaction (`Journal.set_meta`).
    stored: set when the entry is stored, if somebody waits for that.
    """

    entry: Entry
    event: Event | None = None
    advance: float | None = None
    command: Command | None = None
    meta: dict[str, str] = {}
    stored: threading.Event | None = None


def command_received(command: Command, meta: dict[str, str]) -> Received:
    """Return the entry of a command, with the epoch that it begins, if it does."""
    if isinstance(command, Reset | Rewind):
        meta = meta | {"epoch": command.epoch}
    return Received(command_entry(command), command=command, meta=meta)
