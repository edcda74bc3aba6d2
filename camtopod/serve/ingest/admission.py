"""Decode received events, and decide which of them the daemon accepts.

Events come in two ways, and the order of the checks differs:

- A publication is decoded first, so that malformed messages take no camera's place. If it is
  malformed, says another camera than its key, or comes from a camera for which there is no room, it
  is rejected and nothing of it is stored.
- Of a spool's answer the camera is checked first, so that the answers of refused cameras are not
  even decoded. Its events are numbered (boot, seq), and a spool offers what is not acknowledged
  again and again. So an event that cannot be decoded, or says another stream, becomes an entry
  "refused", which is stored in its place but not learned.

An event of either kind that is stamped too far ahead of the clocks becomes an entry "future": it is
stored but not learned. All rejects are counted by reason.
"""

from __future__ import annotations

from collections.abc import Set
from typing import NamedTuple

from camtopod import codec
from camtopod.records import CAMERA_CHARACTERS_MAX, Event
from camtopod.serve.ingest.camera_registry import CameraRegistry, Received
from camtopod.serve.ingest.inbox import Message
from camtopod.serve.outbox import SpoolBatch
from camtopod.serve.runtime import Rejects
from camtopod.serve.storage import Entry

BOX_BYTES_MAX = 64
"""Longest name of a box that is read from a publication, in bytes."""


class SpoolAnswer(NamedTuple):
    """The answer of a spool that was asked for the events of a stream from ``asked_from`` on.

    asked_from: a seq; -1 if the answer is about another stream than the one asked for.
    """

    batch: SpoolBatch
    asked_from: int


class Opened(NamedTuple):
    """The events of a spool's answer.

    entries: one for each event, in the answer's order.
    times (Unix seconds): times of those that were decoded, future ones included.
    """

    entries: list[Received]
    times: list[float]


class Admission:
    """Turns messages into entries for the journal. Used by one thread at a time.

    cameras: registers the cameras, and knows their clocks.
    with_spool: cameras whose publisher has been seen alive; they are preferred.
    rejects: counts what is rejected.
    counts: "received" publications and "future" events are counted here.
    """

    def __init__(
        self,
        cameras: CameraRegistry,
        with_spool: Set[str],
        rejects: Rejects,
        counts: dict[str, int],
    ) -> None:
        self._cameras, self._with_spool = cameras, with_spool
        self._rejects, self._counts = rejects, counts

    def admit(self, message: Message, wall: float, now: float) -> Received | None:
        """Return the entry of a publication; None if it is rejected.

        wall, now: this machine's time in Unix seconds, and a clock that never steps.
        """
        # Decode.
        self._counts["received"] += 1
        camera, raw = message.camera, message.raw
        try:
            event = codec.event_from_bytes(raw)
        except codec.Rejected as error:
            self._rejects.add(error.reason, f"event/{camera}", str(error), raw)
            return None

        # Check the camera.
        if event.camera != camera:
            self._rejects.add(
                "wrong-camera", f"event/{camera}", f"says camera {event.camera!r}", raw
            )
            return None
        if not self._admit_camera(camera, now, raw):
            return None

        # Check the time.
        return self._check_time(event, raw, wall, now, fresh=True, box=message.box)

    def open(self, answer: SpoolAnswer, wall: float, now: float) -> Opened | None:
        """Return the events of a spool's answer; None if its camera is refused."""
        batch = answer.batch
        if not self._admit_camera(batch.camera, now, b""):
            return None

        opened = Opened([], [])
        for seq, raw in batch.events:
            event = self._decode_spooled(batch, seq, raw)
            if event is None:
                kept = raw[: codec.EVENT_BYTES_MAX]
                opened.entries.append(
                    Received(Entry("refused", batch.camera, batch.boot, seq, kept))
                )
            else:
                opened.entries.append(self._check_time(event, raw, wall, now, fresh=False))
                opened.times.append(event.t)
        return opened

    def _admit_camera(self, camera: str, now: float, raw: bytes) -> bool:
        """Return True if the camera is registered; else count a reject."""
        admitted = self._cameras.register(camera, now, self._with_spool)
        if not admitted:
            self._rejects.add(
                "too-many-cameras", f"event/{camera}", "limits.cameras_max is reached", raw
            )
        return admitted

    def _decode_spooled(self, batch: SpoolBatch, seq: int, raw: bytes) -> Event | None:
        """Return an event of an answer; if it is malformed or of another stream, count a reject."""
        where = f"spool/{batch.camera}"
        try:
            event = codec.event_from_bytes(raw)
        except codec.Rejected as error:
            self._rejects.add(error.reason, where, str(error), raw)
            return None
        if (event.camera, event.boot, event.seq) != (batch.camera, batch.boot, seq):
            self._rejects.add("wrong-camera", where, "says another stream", raw)
            return None
        return event

    def _check_time(
        self, event: Event, raw: bytes, wall: float, now: float, fresh: bool, box: str = ""
    ) -> Received:
        """Return the entry of an event; one too far ahead of the clocks is not to be learned."""
        if self._cameras.is_future(event, wall, now, fresh, box):
            self._counts["future"] += 1
            self._rejects.add(
                "future", f"event/{event.camera}", "t is ahead of this machine's clock", raw
            )
            return Received(Entry("future", event.camera, event.boot, event.seq, raw))
        return Received(Entry("event", event.camera, event.boot, event.seq, raw), event)


def read_message(key: str, payload: bytes, attachment: bytes = b"") -> Message:
    """Return the message of a publication on ``event/{camera}``, cut to what it may measure.

    One byte or character too many is kept, so that decoding still finds it too long.

    attachment: the name of the box whose clock has stamped the event.
    """
    return Message(
        key.removeprefix("event/")[: CAMERA_CHARACTERS_MAX + 1],
        payload[: codec.EVENT_BYTES_MAX + 1],
        attachment[:BOX_BYTES_MAX].decode("ascii", "replace"),
    )
