"""Journal entries that correct what was learned, each the beginning of an epoch.

They are replayed like events. A *rewind* follows after a wrong clock has advanced event time:
everything later than a given time is dropped. A *reset* is an operator's command: everything is
dropped.
"""

from __future__ import annotations

from collections.abc import Callable

from msgspec import Struct

from camtopod import codec
from camtopod.admin import Forget, Rename, Reset, TakeBack
from camtopod.serve.storage.journal import Entry, Journal


class _Content(Struct):
    """The content of a correction's entry.

    before: the epoch that ends.
    epoch: the epoch that begins.
    to (Unix seconds): of a rewind, the time after which everything is dropped; of a reset, the time
        before which events are not learned any more.
    """

    before: str
    epoch: str
    to: float | None = None


def rewind(to: float, before: str, epoch: str) -> tuple[Entry, Rewind]:
    """Return the entry for a rewind to ``to`` (Unix seconds), and the learner's input for it."""
    content = _Content(before, epoch, to)
    return Entry("rewind", "", None, None, codec.to_json(content)), Rewind(to, epoch)


def read_rewind(entry: Entry, stored: Callable[[str], dict[int, str]]) -> Rewind:
    """Return the learner's input for the entry of a rewind. Raises `codec.Rejected`.

    stored: returns the digests of an epoch's versions.
    """
    content = codec.read(_Content, entry.raw)
    if content.to is None:
        raise codec.Rejected("malformed", "a rewind without a time")
    return Rewind(content.to, content.epoch, stored(content.epoch))


def reset_entry(command: Reset) -> Entry:
    """Return the entry for a reset."""
    content = _Content(command.before, command.epoch, command.t)
    return Entry("reset", "", None, None, codec.to_json(content))


def read_reset(entry: Entry, stored: Callable[[str], dict[int, str]]) -> Reset:
    """Return the learner's input for the entry of a reset. Raises `codec.Rejected`.

    stored: returns the digests of an epoch's versions.
    """
    content = codec.read(_Content, entry.raw)
    if content.to is None:
        raise codec.Rejected("malformed", "a reset without a time")
    return Reset(content.to, content.before, content.epoch, stored(content.epoch))


def command_entry(command: Forget | TakeBack | Rename) -> Entry:
    """Return the entry for an operator's command that begins no epoch."""
    return Entry("command", "", None, None, codec.to_json(command))


def read_command(entry: Entry) -> Forget | TakeBack | Rename:
    """Return the command of an entry. Raises `codec.Rejected`."""
    command: Forget | TakeBack | Rename = codec.read(
        Forget | TakeBack | Rename,  # type: ignore[arg-type]
        entry.raw,
    )
    return command


def epoch_after(journal: Journal, position: int, epoch: str) -> str:
    """Return the epoch of the versions that follow from a snapshot at the entry ``position``.

    It is ``epoch``, the journal's, unless that began with a correction after the snapshot.

    Raises `sqlite3.Error` and `codec.Rejected`.
    """
    contents = [codec.read(_Content, entry.raw) for _, entry in journal.corrections(position)]
    replayed = contents and contents[-1].epoch == epoch
    return contents[0].before if replayed else epoch


class Rewind(Struct, frozen=True, tag="rewind"):
    """The learner's input for a rewind.

    to (Unix seconds): everything later is dropped.
    epoch: the epoch that begins.
    stored: digests of its versions that may have been published, by version.
    """

    to: float
    epoch: str
    stored: dict[int, str] = {}
