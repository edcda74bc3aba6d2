"""Bytes <-> nouns. The one module that decodes what others wrote, so the one that must survive any
bytes.
"""

from __future__ import annotations

import math
import sys
import types
import typing
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any, TypeVar

import msgspec
from msgspec.structs import force_setattr

from camtopod import soundness
from camtopod.records import Delta, Event, Link, Model, Prediction, Topology

EVENT_ENCODING = "application/msgpack;schema=camtopod.event.1"
EVENT_BYTES_MAX = 4096
"""An event larger than this is refused before it is decoded, bytes."""
T_MIN, T_MAX = -86_400.0, 32_503_680_000.0
"""The times an event may have: to the year 3000; from 1970, as a file's count from 0, and its clock
may be behind.
"""
TRACK_CHARACTERS_MAX = 128
PART_BYTES = 1 << 16
"""What is decoded in one go of a large noun: less than a millisecond."""
_JSON_STARTS = b"{ \t\r\n"
"""An event that begins with one of these is JSON: a MessagePack map begins above 0x7f."""

_json_event = msgspec.json.Decoder(Event)
_pack_event = msgspec.msgpack.Decoder(Event)
_raw_list = msgspec.msgpack.Decoder(list[msgspec.Raw])
_raw_map = msgspec.msgpack.Decoder(dict[str, msgspec.Raw])
_to_json = msgspec.json.Encoder()
_to_pack = msgspec.msgpack.Encoder()
_UNREADABLE = (msgspec.MsgspecError, ValueError, RecursionError)
_T = TypeVar("_T")


class Rejected(ValueError):
    """The other side's bytes do not fit. ``reason`` is a short stable word for counting, ``str()``
    says what and where.
    """

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(detail)
        self.reason = reason


def event_from_json(line: bytes | str) -> Event:
    """One event line (contract 2) to an `Event`; raises `Rejected`."""
    return _event(
        _json_event, line.encode("utf-8", "surrogatepass") if isinstance(line, str) else line
    )


def event_from_pack(payload: bytes) -> Event:
    """The same record from MessagePack; raises `Rejected`."""
    return _event(_pack_event, payload)


def event_from_bytes(raw: bytes) -> Event:
    """An event as MessagePack, or as JSON; raises `Rejected`."""
    return _event(_json_event if raw and raw[0] in _JSON_STARTS else _pack_event, raw)


def _event(decoder: Any, raw: bytes) -> Event:
    if len(raw) > EVENT_BYTES_MAX:
        raise Rejected("too-long", f"more than {EVENT_BYTES_MAX} bytes")
    try:
        event: Event = decoder.decode(raw)
    except _UNREADABLE as error:
        raise _rejection(error) from None
    x, y, track = event.x, event.y, event.track
    if not T_MIN <= event.t < T_MAX:  # not-a-number is neither
        raise Rejected("bad-value", "t is not a time between 1970 and 3000 - at `$.t`")
    if (x is None) != (y is None):
        raise Rejected("half-position", "x and y go together: send both or neither")
    if not math.isfinite((x or 0.0) + (y or 0.0) + (event.clock_sd or 0.0)):
        [name, *_] = [
            name
            for name in ("x", "y", "clock_sd")
            if not math.isfinite(getattr(event, name) or 0.0)
        ]
        raise Rejected("bad-value", f"{name} is not a finite number - at `$.{name}`")
    if (event.boot is None) != (event.seq is None):
        raise Rejected("half-sequence", "boot and seq go together: send both or neither")
    if isinstance(track, int):
        if len(str(track)) > TRACK_CHARACTERS_MAX:  # JSON has whole numbers of any length
            raise Rejected(
                "bad-value",
                f"track is longer than {TRACK_CHARACTERS_MAX} characters - at `$.track`",
            )
        event = msgspec.structs.replace(event, track=str(track))
    # names are one string for all events that wait or are held, which is a third of the memory of
    # each
    force_setattr(event, "camera", sys.intern(event.camera))
    if event.boot is not None:
        force_setattr(event, "boot", sys.intern(event.boot))
    return event


def _decode(decoder: Any, raw: bytes) -> Any:
    try:
        return decoder.decode(raw)
    except _UNREADABLE as error:
        raise _rejection(error) from None


def _rejection(error: Exception) -> Rejected:
    if isinstance(error, msgspec.ValidationError):
        return Rejected("bad-value", str(error))
    if isinstance(error, UnicodeDecodeError):  # msgspec lets it through (msgspec#714)
        return Rejected("not-utf8", "text is not UTF-8")
    if isinstance(error, RecursionError):
        return Rejected("too-deep", "nested too deeply")
    return Rejected("malformed", str(error))


def read(kind: type[_T], raw: bytes, pack: bool = False) -> _T:
    """Any other noun from JSON (or MessagePack); raises `Rejected`."""
    decoder: Any = msgspec.msgpack.Decoder(kind) if pack else msgspec.json.Decoder(kind)
    result: _T = _decode(decoder, raw)
    return result


def read_topology(raw: bytes, pack: bool = False) -> Topology:
    """A topology in which every name stands for something in it, and every figure can be so; raises
    `Rejected`. Its reader need not ask again.
    """
    topology = read(Topology, raw, pack)
    cameras = {camera.id for camera in topology.cameras}
    zones = {zone.id for zone in topology.zones}
    for known, kind, named in (
        (
            cameras,
            "camera",
            ((f"zones[{k}].camera", zone.camera) for k, zone in enumerate(topology.zones)),
        ),
        (
            zones,
            "zone",
            (
                (f"cameras[{k}].zones", zone)
                for k, one in enumerate(topology.cameras)
                for zone in one.zones
            ),
        ),
        (zones, "zone", _ends("links", topology.links)),
        (zones, "zone", _ends("weak_links", topology.weak_links or [])),
        (zones, "zone", () if topology.model is None else _zones_of(topology.model)),
        (
            cameras,
            "camera",
            (
                (f"pairs[{k}]", name)
                for k, pair in enumerate(topology.pairs)
                for name in pair.cameras
            ),
        ),
    ):
        for place, name in named:
            if name not in known:
                raise Rejected(
                    "unknown-name", f"there is no {kind} {name!r} in it - at `$.{place}`"
                )
    for problem in soundness.problems(topology):
        raise Rejected("bad-value", problem)
    return topology


def _ends(field: str, links: Sequence[Link]) -> Iterator[tuple[str, str]]:
    for k, link in enumerate(links):
        yield f"{field}[{k}].from", link.from_
        yield f"{field}[{k}].to", link.to


def _zones_of(model: Model) -> Iterator[tuple[str, str]]:
    """The zones that prediction looks up, each with its place."""
    for k, zone in enumerate(model.zones):
        yield f"model.zones[{k}].zone", zone.zone
    for k, onward in enumerate(model.onward or []):
        yield f"model.onward[{k}].zone", onward.zone
        for n, outcome in enumerate(onward.next_):
            yield f"model.onward[{k}].next_[{n}].to", outcome.to
    for k, kernel in enumerate(model.entered or []):
        yield f"model.entered[{k}].zone", kernel.zone
        yield f"model.entered[{k}].to", kernel.to
    for k, context in enumerate(model.contexts or []):
        yield from ((f"model.contexts[{k}]", name) for name in (context.zone, *context.to))
        if context.entry is not None:
            yield f"model.contexts[{k}].entry", context.entry
    for k, way in enumerate(model.pace.ways if model.pace is not None else []):
        yield f"model.pace.ways[{k}].entry", way.entry
        yield f"model.pace.ways[{k}].exit", way.exit


def _no_pause() -> None:
    """At once."""


def read_in_parts(
    kind: Any,
    raw: bytes | msgspec.Raw,
    pause: Callable[[], None] = _no_pause,
    left_out: Collection[str] = (),
) -> Any:
    """The same from MessagePack for large nouns: decoded in one go, no other thread would get a
    turn meanwhile. ``pause`` is called before each part. ``left_out``: lists of the noun that are
    not read and come out empty, in one that is large.
    """
    pause()
    if len(raw) <= PART_BYTES:
        return _decode(msgspec.msgpack.Decoder(kind), raw)
    if isinstance(kind, types.UnionType):
        large = [
            one for one in typing.get_args(kind) if one is not types.NoneType
        ]  # None is not as large
        kind = large[0] if len(large) == 1 else kind
    if typing.get_origin(kind) is list:
        (item,) = typing.get_args(kind)
        decoder, items = msgspec.msgpack.Decoder(item), []
        for part in _decode(_raw_list, raw):
            pause()
            items.append(
                _decode(decoder, part)
                if len(part) <= PART_BYTES
                else read_in_parts(item, part, pause)
            )
        return items
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        parts = _decode(_raw_map, raw)
        fields = msgspec.structs.fields(kind)
        if missing := [
            field.encode_name
            for field in fields
            if field.required and field.encode_name not in parts
        ]:
            raise Rejected("bad-value", f"{kind.__name__} without {missing[0]}")
        known = [
            field for field in fields if field.encode_name in parts and field.name not in left_out
        ]
        empty: dict[str, Any] = {name: [] for name in left_out}
        read = {
            field.name: read_in_parts(field.type, parts[field.encode_name], pause)
            for field in known
        }
        return kind(**read, **empty)
    return _decode(msgspec.msgpack.Decoder(kind), raw)


def to_json(noun: Event | Topology | Delta | Prediction | Any) -> bytes:
    """JSON on one line, without the newline."""
    return _to_json.encode(noun)


def to_pack(noun: Event | Topology | Delta | Prediction | Any) -> bytes:
    """MessagePack."""
    return _to_pack.encode(noun)
