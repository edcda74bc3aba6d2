"""Journal entries that correct what was learned, each the beginning of an epoch.

They are replayed like events. A *rewind* follows after a wrong clock has advanced event time:
everything later than a given time is dropped. A *reset* is an operator's command: everything is
dropped. A *leave-out* follows after the learner has failed
repeatedly: the events that one camera has sent since the last snapshot are left out. If memory has
run out, the camera's events in the snapshot are left out, too, as it is the camera that has sent
most. The learner cannot reach such an entry before it has passed those events, so corrections are
read before the replay.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import NamedTuple

from msgspec import Struct

from camtopod import codec
from camtopod.admin import Forget, Rename, Reset, TakeBack
from camtopod.serve.storage.journal import Entry, Journal

log = logging.getLogger(__name__)

LEAVE_OUTS_MAX = 8
"""Most cameras left out after one snapshot; if the learner still fails, the cause is another."""


class _Content(Struct):
    """The content of a correction's entry.

    before: the epoch that ends.
    epoch: the epoch that begins.
    to (Unix seconds): of a rewind, the time after which everything is dropped; of a reset, the time
        before which events are not learned any more.
    forget: of a leave-out, True if the camera's events in the snapshot are left out, too.
    """

    before: str
    epoch: str
    to: float | None = None
    forget: bool = False


class Corrections(NamedTuple):
    """The corrections after a snapshot.

    epoch: epoch of the versions that follow from the snapshot; None if it is the journal's.
    left_out: by camera, the entry up to which its events are left out.
    forgotten: cameras whose events in the snapshot are left out, too.
    """

    epoch: str | None
    left_out: dict[str, int]
    forgotten: list[str]


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


def leave_out(camera: str, before: str, epoch: str, forget: bool) -> Entry:
    """Return the entry for leaving out what ``camera`` has sent since the snapshot.

    forget: leave out its events in the snapshot, too.
    """
    return Entry(
        "leave-out", camera, None, None, codec.to_json(_Content(before, epoch, forget=forget))
    )


def read_corrections(journal: Journal, after: int, epoch: str) -> Corrections:
    """Return the corrections after the entry ``after``; ``epoch`` is the journal's.

    Raises `sqlite3.Error` and `codec.Rejected`.
    """
    found = [
        (number, entry, codec.read(_Content, entry.raw))
        for number, entry in journal.corrections(after)
    ]
    left_out = {entry.camera: number for number, entry, _ in found if entry.kind == "leave-out"}
    replayed = found and not left_out and found[-1][2].epoch == epoch
    forgotten = sorted({entry.camera for _, entry, content in found if content.forget})
    return Corrections(found[0][2].before if replayed else None, left_out, forgotten)


def camera_to_leave_out(journal: Journal, after: int, failed_at: int, most: bool) -> str | None:
    """Return the camera whose events after the entry ``after`` to leave out; None if there is none.

    failed_at: the entry at which the learner fails.
    most: True asks for the camera that has sent most, if none was left out yet.

    By default it is the camera of the entry ``failed_at`` or, when the events of that one are left
    out already, the camera that has sent most. Returns None after `LEAVE_OUTS_MAX` cameras, too.
    Raises `sqlite3.Error`.
    """

    before = [
        (number, entry.camera)
        for number, entry in journal.corrections(after)
        if entry.kind == "leave-out"
    ]

    if len(before) >= LEAVE_OUTS_MAX:
        return None

    # Count each camera's events that are not left out yet.
    sent = journal.count_events(after, failed_at)
    for number, camera in before:
        sent[camera] = journal.count_events(number, failed_at).get(camera, 0)

    # Take the camera of the failing entry, or the one with most events.
    [sender] = [
        entry.camera for _, entry in journal.entries(failed_at - 1, failed_at) if entry is not None
    ] or [""]
    if (before or not most) and sent.get(sender):
        return sender
    largest = max(sent, key=lambda camera: (sent[camera], camera), default=None)
    return largest if largest is not None and sent[largest] else None


class Rewind(Struct, frozen=True, tag="rewind"):
    """The learner's input for a rewind.

    to (Unix seconds): everything later is dropped.
    epoch: the epoch that begins.
    stored: digests of its versions that may have been published, by version.
    """

    to: float
    epoch: str
    stored: dict[int, str] = {}
