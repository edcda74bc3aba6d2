"""The requests by which a grabber's spool delivers its events, and the daemon's answers.

Both travel as a query on ``store/{camera}``, one at a time for each camera. `deploy/protocol.md`
has the rules; `camtopod.serve.outbox` follows them on the grabber's side, and
`camtopod.serve.ingest` on the daemon's.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from camtopod import codec
from camtopod.records import NAME_PATTERN

SEQ_MAX = 2**63 - 1
"""Largest sequence number."""
BATCH_EVENTS_MAX = 500
"""Most events in one request."""
BATCH_BYTES_MAX = 64 * 1024
"""Most bytes of events in one request; a single event may always be sent."""
BOOTS_MAX = 1_000
"""Most boots of one camera that a hello names."""
ANSWER_SECONDS_MAX = 150.0
"""Time that a grabber waits for an answer."""
HELD_SECONDS_MAX = 60.0
"""Time after which the daemon answers ``held`` to a batch that it has taken and not yet stored."""

Seq = Annotated[int, Meta(ge=1, le=SEQ_MAX)]
"""Number of an event within the boot and the camera."""
Mark = Annotated[int, Meta(ge=0, le=SEQ_MAX)]
"""The highest number of a boot of which something is known; 0 if nothing is."""
Boot = Annotated[str, Meta(min_length=1, max_length=64)]
"""Incarnation of a publisher."""
Number = Annotated[str, Meta(min_length=1, max_length=32, pattern=NAME_PATTERN)]
"""Random text that a grabber draws for each hello."""
Reason = Literal["", "malformed", "hello", "held", "busy", "clock", "cameras"]
"""Why nothing more is taken.

malformed: the request cannot be read. hello: the batch has the number of another hello. held: the
batch is taken and waits to be stored. busy: there is no room. clock: the daemon's clock is behind
the events. cameras: ``cameras_max`` is reached.
"""


class Hello(Struct, frozen=True, tag="hello"):
    """The first request: which boots a camera's spool holds, oldest first.

    The camera's next batches carry its ``number``.
    """

    number: Number
    boots: Annotated[list[Boot], Meta(max_length=BOOTS_MAX)]


class Batch(Struct, frozen=True, tag="batch"):
    """Events of one boot, by rising number.

    number: of the camera's last hello.
    after: the last ``have`` in the daemon's answers for this boot, or less; 0 if none. Events
        between it and the first of the batch that the daemon does not have are lost. Of a batch
        without events, the number up to which events were sent.
    events: (seq, bytes); empty to ask when all up to ``after`` is stored.
    more: how many events of the camera wait behind these.
    """

    number: Number
    boot: Boot
    after: Mark
    events: Annotated[list[tuple[Seq, bytes]], Meta(max_length=BATCH_EVENTS_MAX)]
    more: Annotated[int, Meta(ge=0)] = 0


class Answer(Struct, frozen=True, omit_defaults=True):
    """The daemon's answer.

    have: for the boot of the batch, or each of the hello's, the highest number that is on disk; 0
        if none is.
    batch: how many events the next batch may have.
    reason: why nothing was taken, or that the batch is held; "" if ``have`` says it all.
    detail: the reason as a sentence for people.
    late: how many events of the batch are older than those learned last.
    refused: how many of them were malformed, too many, or too far ahead of the clock.
    """

    have: dict[Boot, Mark]
    batch: Annotated[int, Meta(ge=1, le=BATCH_EVENTS_MAX)] = 1
    reason: Reason = ""
    detail: str = ""
    late: int = 0
    refused: int = 0


def read_request(payload: bytes) -> Hello | Batch:
    """Return the request in MessagePack. Raises `codec.Rejected`."""
    request: Hello | Batch = codec.read(
        Hello | Batch,  # type: ignore[arg-type]
        payload,
        pack=True,
    )
    if isinstance(request, Batch):
        seq = request.after
        for next_seq, _ in request.events:
            if next_seq <= seq:
                raise codec.Rejected("bad-batch", "the events are not by rising seq after `after`")
            seq = next_seq
    return request
