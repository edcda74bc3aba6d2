"""What the daemon receives, on its way into the journal.

An invalid event from a spool is stored under its number, so that the spool can delete it, and is
not learned. An invalid publication is dropped.
"""

from __future__ import annotations

import re

from msgspec import Struct
from msgspec.structs import replace

from camtopod import codec
from camtopod.admin import Command, Reset, Rewind
from camtopod.records import CAMERA_PATTERN, Event
from camtopod.serve.requests import Batch, Hello, read_request
from camtopod.serve.runtime import Rejects
from camtopod.serve.storage import Entry, command_entry


class Received(Struct, frozen=True, gc=False):
    """An entry on its way into the journal, and its effect on the learner.

    event: the event to be learned; None if it is only stored.
    advance: event time that advances without an event, Unix seconds.
    waited: cameras that the learner waits for from here on.
    command: a command.
    meta: what is stored under other keys in the same transaction (`Journal.set_meta`).
    """

    entry: Entry
    event: Event | None = None
    advance: float | None = None
    waited: frozenset[str] | None = None
    command: Command | None = None
    meta: dict[str, str] = {}

    def set_aside(self) -> Received:
        """Return the entry by which an event from the future is stored and not learned."""
        return Received(replace(self.entry, kind="future"))

    def only_number(self) -> Received:
        """Return the entry by which an event's number alone is stored, as a disk is finite."""
        return Received(replace(self.entry, kind="refused", raw=b""))


def command_received(command: Command, meta: dict[str, str]) -> Received:
    """Return the entry of a command, with the epoch that it begins, if it does."""
    if isinstance(command, Reset | Rewind):
        meta = meta | {"epoch": command.epoch}
    return Received(command_entry(command), command=command, meta=meta)


def request_of(camera: str, content: bytes) -> Hello | Batch:
    """Return a request on ``store/{camera}``. Raises `codec.Rejected`."""
    if not re.match(CAMERA_PATTERN, camera):
        raise codec.Rejected("bad-value", "the key names no camera")
    return read_request(content)


def event_of(camera: str, content: bytes, on_label: codec.OnLabel) -> Event:
    """Return an event on a key of ``camera``; an invalid label is passed on and left out.

    Raises `codec.Rejected`.
    """
    event = codec.event_from_bytes(content, on_label)
    if event.camera != camera:
        raise codec.Rejected("wrong-camera", f"says camera {event.camera!r}")
    return event


def spooled_event(camera: str, boot: str, seq: int, raw: bytes, rejects: Rejects) -> Received:
    """Return the entry of an event from a camera's spool; invalid ones are counted."""

    def reject(error: codec.Rejected) -> None:
        rejects.add(error.reason, f"store/{camera}", str(error), raw)

    try:
        return Received(Entry("event", camera, boot, seq, raw), event_of(camera, raw, reject))
    except codec.Rejected as error:
        reject(error)
        return Received(Entry("refused", camera, boot, seq, raw[: codec.EVENT_BYTES_MAX]))
