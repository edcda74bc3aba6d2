"""Entries of the journal that correct what had been learned. Each begins an epoch, and is replayed
like an event.

A *rewind*: a wrong clock had taken event time along; what is later than a moment is dropped,
everything else stays. A *leave-out*: the learner had failed again and again; what one camera has
sent since the last snapshot is left out, everything else stays. Where memory had run out, so is
what the snapshot has of that camera: it is the one that has sent most. As the learner cannot come
to such an entry before it has passed those events, it is looked for ahead of the replay.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import NamedTuple

from msgspec import Struct

from camtopod import codec
from camtopod.serve.storage.journal import Entry, Journal

log = logging.getLogger(__name__)

LEAVE_OUTS_MAX = 8
"""Cameras left out behind one snapshot; if the learner goes on failing, the cause is another."""


class _Content(Struct):
    """``before``: the epoch that ends; ``to``: of a rewind, Unix seconds; ``forget``: of a
    leave-out, whether what the snapshot has of the camera is left out, too.
    """

    before: str
    epoch: str
    to: float | None = None
    forget: bool = False


class Corrections(NamedTuple):
    """What the journal has behind a snapshot. ``epoch``: that of the versions that follow from the
    snapshot, None if it is the journal's; ``left_out``: by camera the entry up to which its events
    are left out; ``forgotten``: cameras of which what the snapshot has is, too.
    """

    epoch: str | None
    left_out: dict[str, int]
    forgotten: list[str]


def rewind(to: float, before: str, epoch: str) -> tuple[Entry, Rewind]:
    """The entry for a rewind to ``to`` (Unix seconds), and what it teaches."""
    content = _Content(before, epoch, to)
    return Entry("rewind", "", None, None, codec.to_json(content)), Rewind(to, epoch)


def read_rewind(entry: Entry, stored: Callable[[str], dict[int, str]]) -> Rewind:
    """What a rewind teaches; ``stored`` gives the digests of an epoch's versions. Raises
    `codec.Rejected`.
    """
    content = codec.read(_Content, entry.raw)
    if content.to is None:
        raise codec.Rejected("malformed", "a rewind without a time")
    return Rewind(content.to, content.epoch, stored(content.epoch))


def leave_out(camera: str, before: str, epoch: str, forget: bool) -> Entry:
    """The entry for leaving out what ``camera`` has sent since the snapshot; ``forget``: and
    before.
    """
    return Entry(
        "leave-out", camera, None, None, codec.to_json(_Content(before, epoch, forget=forget))
    )


def corrections(journal: Journal, after: int, epoch: str) -> Corrections:
    """Those behind the entry ``after``; ``epoch`` is the journal's. Raises `sqlite3.Error`,
    `codec.Rejected`.
    """
    found = [
        (number, entry, codec.read(_Content, entry.raw))
        for number, entry in journal.corrections(after)
    ]
    left_out = {entry.camera: number for number, entry, _ in found if entry.kind == "leave-out"}
    only_rewinds = found and not left_out and found[-1][2].epoch == epoch
    forgotten = sorted({entry.camera for _, entry, content in found if content.forget})
    return Corrections(found[0][2].before if only_rewinds else None, left_out, forgotten)


def offender(journal: Journal, after: int, failed_at: int, most: bool) -> str | None:
    """Whose events to leave out of those behind the entry ``after``, as the learner fails at the
    entry ``failed_at``: those of that entry's camera or, when it is left out already or if the one
    that has sent ``most`` is asked for, of that one. None if there is none, or too many were left
    out. Raises `sqlite3.Error`.
    """
    before = [
        (number, entry.camera)
        for number, entry in journal.corrections(after)
        if entry.kind == "leave-out"
    ]
    if len(before) >= LEAVE_OUTS_MAX:
        return None
    sent = journal.senders(after, failed_at)
    for number, camera in before:
        sent[camera] = journal.senders(number, failed_at).get(camera, 0)
    [sender] = [
        entry.camera for _, entry in journal.entries(failed_at - 1, failed_at) if entry is not None
    ] or [""]
    if (before or not most) and sent.get(sender):
        return sender
    largest = max(sent, key=lambda camera: (sent[camera], camera), default=None)
    return largest if largest is not None and sent[largest] else None


class Rewind(Struct, frozen=True):
    """Event time had been taken along by a wrong clock: what is later than ``to`` (seconds) is
    dropped, and ``epoch`` begins. ``stored``: digests of its versions that may have been published.
    """

    to: float
    epoch: str
    stored: dict[int, str] = {}
