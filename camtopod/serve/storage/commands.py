"""Commands as entries of the journal: they are replayed in their place, like events."""

from __future__ import annotations

from camtopod import codec
from camtopod.admin import Command, Reset, Rewind
from camtopod.serve.storage.journal import Entry


def command_entry(command: Command) -> Entry:
    """Return the entry for a command; one that begins an epoch is a ``correction``."""
    kind = "correction" if isinstance(command, Reset | Rewind) else "command"
    return Entry(kind, "", None, None, codec.to_json(command))  # type: ignore[arg-type]


def read_command(raw: bytes) -> Command:
    """Return the command in an entry's ``raw``. Raises `codec.Rejected`."""
    command: Command = codec.read(Command, raw)  # type: ignore[arg-type]
    return command
