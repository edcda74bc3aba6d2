"""Decode messages from the bus.

An invalid event from a spool is stored under its number, so that the spool can delete it, and is
not learned. An invalid publication is dropped.
"""

from __future__ import annotations

import re

from camtopod import codec
from camtopod.records import CAMERA_PATTERN, Event
from camtopod.serve.ingest.received import Received
from camtopod.serve.requests import Batch, Hello, read_request
from camtopod.serve.runtime import Rejects
from camtopod.serve.storage import Entry


def request(camera: str, content: bytes) -> Hello | Batch:
    """Return a request on ``store/{camera}``. Raises `codec.Rejected`."""
    if not re.match(CAMERA_PATTERN, camera):
        raise codec.Rejected("bad-value", "the key names no camera")
    return read_request(content)


def entry(camera: str, boot: str, seq: int, raw: bytes, rejects: Rejects) -> Received:
    """Return the entry of an event from a camera's spool; invalid ones are counted."""
    try:
        event = codec.event_from_bytes(raw)
        if event.camera != camera:
            raise codec.Rejected("wrong-camera", f"says camera {event.camera!r}")
    except codec.Rejected as error:
        rejects.add(error.reason, f"store/{camera}", str(error), raw)
        return Received(Entry("refused", camera, boot, seq, raw[: codec.EVENT_BYTES_MAX]))
    return Received(Entry("event", camera, boot, seq, raw), event)


def published(camera: str, content: bytes) -> Event:
    """Return an event that was published on ``event/{camera}``. Raises `codec.Rejected`."""
    event = codec.event_from_bytes(content)
    if event.camera != camera:
        raise codec.Rejected("wrong-camera", f"says camera {event.camera!r}")
    return event
