"""Events of the cameras, and those of the last hour as a reader may see them."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from camtopod.labels import LABEL_CHARACTERS_MAX
from camtopod.records.field_types import CameraId, Kind, Seconds


class Event(Struct, frozen=True, omit_defaults=True, gc=False):
    """One object that appears in the view of a camera (``entry``) or leaves it (``exit``).

        >>> from camtopod import Event
        >>> Event("lobby", "exit", 1_700_000_000.25, x=0.31, y=0.88, track="17").kind
        'exit'

    t: time of capture.
    x, y: foot point; both or neither.
    track: ties the entry and the exit of one passage through this camera's view.
    boot, seq: incarnation of the publisher, and a count without gaps within it and the camera; both
        or neither. With them an event that is delivered twice counts once.
    clock_sd (seconds): standard deviation of ``t``.
    spooled: on the bus only, the publisher delivers this event by ``store/{camera}`` as well: the
        daemon hears it, for predictions, and stores it then.
    label: class of the object, such as ``person`` or ``car``; never what tells one from another.
    """

    camera: CameraId
    kind: Kind
    t: Seconds
    x: Annotated[float, Meta(ge=0, le=1)] | None = None
    y: Annotated[float, Meta(ge=0, le=1)] | None = None
    track: Annotated[str, Meta(max_length=128)] | int | None = None
    boot: Annotated[str, Meta(max_length=64)] | None = None
    seq: Annotated[int, Meta(ge=0, le=2**63 - 1)] | None = None
    clock_sd: Annotated[float, Meta(ge=0, le=1e6)] | None = None
    spooled: bool = False
    label: Annotated[str, Meta(max_length=LABEL_CHARACTERS_MAX)] | None = None


class SeenEvent(Struct, frozen=True, omit_defaults=True):
    """An event of the last hour as a reader may see it: without its track.

    zone: None if its camera has no zone yet.
    label: class of the object, if it is one of those that count.
    """

    t: float
    camera: str
    kind: Kind
    zone: str | None = None
    x: float | None = None
    y: float | None = None
    label: str | None = None


class EventHours(Struct, frozen=True):
    """Entries and exits by the hour, for a day.

    since: when counting began, Unix seconds; a start of the daemon begins anew.
    first: when the first of the hours begins.
    cameras: by camera: entries and exits of each hour.
    """

    since: float
    first: float
    cameras: dict[str, list[list[int]]]


class Recent(Struct, frozen=True, omit_defaults=True):
    """Events of the last hour up to the newest event, in the order in which they were received.

    t: moment of the answer.
    hours: only if asked for.
    """

    t: float
    events: list[SeenEvent]
    hours: EventHours | None = None
