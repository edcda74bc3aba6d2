"""What the daemon receives, on its way into the journal."""

from __future__ import annotations

import threading

from msgspec import Struct

from camtopod.admin import Command
from camtopod.records import Event
from camtopod.serve.storage import Entry


class Received(Struct, frozen=True, gc=False):
    """An entry on its way into the journal, and its effect on the learner.

    event: the event to be learned; None if it is only stored.
    advance: event time that advances without an event, Unix seconds.
    command: a command.
    names: with a command, the state of all names after it, as it is stored (`Names`).
    stored: set when the entry is stored, if somebody waits for that.
    """

    entry: Entry
    event: Event | None = None
    advance: float | None = None
    command: Command | None = None
    names: str | None = None
    stored: threading.Event | None = None
