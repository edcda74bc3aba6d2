"""Encode and decode the public data types as JSON and MessagePack.

All bytes of other programs are decoded here, so no input may do more than raise `Rejected`.
"""

from __future__ import annotations

import functools
import math
import re
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, get_args

import msgspec
from msgspec.structs import force_setattr

from camtopod import older, soundness
from camtopod.labels import plain
from camtopod.records import (
    CAMERA_PATTERN,
    Delta,
    Event,
    Kind,
    Prediction,
    Topology,
)

EVENT_BYTES_MAX = 4096
"""Largest event, in bytes; a larger one is rejected before it is decoded."""
T_MIN = -86_400.0
T_MAX = 32_503_680_000.0
"""Range of an event's time, seconds since 1970.

It ends with the year 3000, and begins a day before 1970: the times of a file may count from 0, and
its clock may be slow.
"""
RECORD_T_MAX = 1e11
"""Largest time of a record, either way (`camtopod.records`): files count in seconds of any epoch,
but not in milliseconds.
"""
TRACK_CHARACTERS_MAX = 128
"""Longest track, in characters or digits."""
_JSON_STARTS = (b"{", b" ", b"\t", b"\r", b"\n")
"""First bytes of an event in JSON; a MessagePack map begins above 0x7f."""


class _Stamp(msgspec.Struct):
    """Camera and time alone of an event."""

    t: float
    camera: str = ""


_json_event = msgspec.json.Decoder(Event)
_json_stamp = msgspec.json.Decoder(_Stamp)
_json_value = msgspec.json.Decoder(msgspec.Raw)
_pack_event = msgspec.msgpack.Decoder(Event)
_to_json = msgspec.json.Encoder()
_to_pack = msgspec.msgpack.Encoder()
_making = threading.Lock()
_UNREADABLE = (msgspec.MsgspecError, ValueError, RecursionError)
"""What msgspec's decoders raise on bad input."""
_KINDS = get_args(Kind)
_matches_camera = re.compile(CAMERA_PATTERN).match
_T = TypeVar("_T")
_NO_TIME = (
    "t is no number of seconds between 1970 and 3000 (milliseconds, or text?), nor ISO 8601 in a "
    "table - at `$.t`"
)
_NO_PLACE = (
    "x and y are fractions of the picture, 0 to 1 (pixels, or percent?): divide them by its width "
    "and height"
)
_IN_WORDS = {
    "`$.t`": _NO_TIME,
    "`$.kind`": "kind is entry or exit, in no other words - at `$.kind`",
    "`$.x`": f"{_NO_PLACE} - at `$.x`",
    "`$.y`": f"{_NO_PLACE} - at `$.y`",
}
"""Mistakes of an event in words, by the field that msgspec's error names."""
_AT_TRACK = " - at `$.track`"
_AT_LABEL = " - at `$.label"
"""In the mistake of an event whose label is of the wrong type, or too long."""
_CUT_OFF = "Input data was truncated"
_NOT_UTF8 = "Invalid UTF-8 encoded string"
"""msgspec's messages for input that ends too early, and for text that is not UTF-8 (before 0.23 it
let Python's own error through).
"""


class Rejected(ValueError):
    """Input from another program is not valid.

    ``reason`` is a short stable word for counting; ``str()`` names the mistake and its place.
    """

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(detail)
        self.reason = reason


def is_camera(name: str) -> bool:
    """Return True if a camera may have this id."""
    return _matches_camera(name) is not None


def require_camera(name: str) -> None:
    """Raise `ValueError` unless a camera may have this id."""
    if not is_camera(name):
        rule = "1 to 64 of the characters A-Z a-z 0-9 _ . -, and not daemon"
        raise ValueError(f"camera {name!r}: {rule}")


def require_event(event: Event, kind: Kind | None = None) -> None:
    """Raise `Rejected` for an event that is none, or of another kind; TypeError for another type.

    Events from files and from the bus are checked as they are decoded; this is for those that a
    Python program has made. Camera, time and position are refused in the words of an event line;
    a time may be any that a record may have.
    """
    time_of(event)
    x, y = event.x, event.y
    if event.kind not in _KINDS:
        mistake = ": the kind of an event is entry or exit"
    elif not (
        -RECORD_T_MAX <= event.t <= RECORD_T_MAX
        and _matches_camera(event.camera)
        and (0 <= x <= 1 and 0 <= y <= 1 if x is not None and y is not None else x is y)
    ):
        mistake = f": {_mistake_of_line(event)}"
    elif kind not in (None, event.kind):
        mistake = f" among what should be {kind} events"
    else:
        return
    raise Rejected("bad-value", f"an {event.kind} of {event.camera} at {event.t}{mistake}")


def time_of(event: Event) -> float:
    """Return the time of an event; raise TypeError for another type."""
    if not isinstance(event, Event):
        raise TypeError(f"{event!r:.100} is no camtopod.Event; load_events reads them from a file")
    return event.t


def _mistake_of_line(event: Event) -> str:
    """Return why no event line may have this camera, time or position."""
    numbers = {"t": event.t, "x": event.x, "y": event.y}
    fields = {name: float(value) for name, value in numbers.items() if value is not None}
    try:
        event_from_msgpack(to_msgpack({"camera": event.camera, "kind": event.kind, **fields}))
    except Rejected as rejection:
        return str(rejection)
    return "no event"


OnLabel = Callable[[Rejected], None]
"""Called with the mistake of an invalid label; the event stays, without it."""


def event_from_json(line: bytes | str, on_label: OnLabel | None = None) -> Event:
    """Return the event of one line of JSON; raise `Rejected`."""
    if isinstance(line, str):
        line = line.encode("utf-8", "surrogatepass")
    return _event(_json_event, line, on_label)


def event_from_msgpack(payload: bytes, on_label: OnLabel | None = None) -> Event:
    """Return the event of a MessagePack payload; raise `Rejected`."""
    return _event(_pack_event, payload, on_label)


def event_from_bytes(raw: bytes, on_label: OnLabel | None = None) -> Event:
    """Return the event of a payload in MessagePack or JSON; raise `Rejected`."""
    if raw.startswith(_JSON_STARTS):
        return event_from_json(raw, on_label)
    return event_from_msgpack(raw, on_label)


def _event(decoder: Any, raw: bytes, on_label: OnLabel | None) -> Event:
    if len(raw) > EVENT_BYTES_MAX:
        raise Rejected("too-long", f"more than {EVENT_BYTES_MAX} bytes")
    bad_label: Rejected | None = None
    try:
        try:
            event: Event = decoder.decode(raw)
        except msgspec.ValidationError as error:
            if _AT_LABEL in str(error):
                bad_label = Rejected("bad-label", str(error))
            elif _AT_TRACK not in str(error):
                raise
            event = _mended(raw, bad_label is not None)
    except _UNREADABLE as error:
        rejection = _rejection(error)
        if (words := _IN_WORDS.get(str(rejection).rpartition(" - at ")[2])) is not None:
            rejection = Rejected("bad-value", words)
        elif rejection.reason == "malformed" and b"NaN" in raw:
            rejection = Rejected("malformed", "NaN is not JSON: write null, or leave the field out")
        elif decoder is _json_event and b"{" in raw and raw.lstrip()[:1] not in b"{[":
            words = "text stands before the event: cut it off, with sed 's/^[^{]*//' for example"
            rejection = Rejected("malformed", words)
        raise rejection from None

    # Check relations and values that the types cannot express.
    x = event.x
    y = event.y
    track = event.track
    if not T_MIN <= event.t < T_MAX:  # also true for NaN
        raise Rejected("bad-value", _NO_TIME)
    if (x is None) != (y is None):
        raise Rejected("half-position", "x and y go together: send both or neither")
    if not math.isfinite((x or 0.0) + (y or 0.0) + (event.clock_sd or 0.0)):
        raise Rejected("bad-value", "x, y or clock_sd is not a finite number")
    if (event.boot is None) != (event.seq is None):
        raise Rejected("half-sequence", "boot and seq go together: send both or neither")

    # Tracks are strings from here on.
    if isinstance(track, int):
        text = str(track)
        if len(text) > TRACK_CHARACTERS_MAX:  # JSON integers may have any length
            raise Rejected("bad-value", "track is too long a number - at `$.track`")
        event = msgspec.structs.replace(event, track=text)

    # Labels are plain; one without a letter or a digit is none.
    if event.label is not None:
        label = plain(event.label)
        force_setattr(event, "label", sys.intern(label) if label else None)
        if not label:
            bad_label = Rejected("bad-label", "label has no letter or digit - at `$.label`")
    if bad_label is not None and on_label is not None:
        on_label(bad_label)

    # All events share one string per name, which saves a third of their memory.
    force_setattr(event, "camera", sys.intern(event.camera))
    if event.boot is not None:
        force_setattr(event, "boot", sys.intern(event.boot))
    return event


def _mended(raw: bytes, without_label: bool) -> Event:
    """Return the event of a payload, with a whole number for a track that is a float like 17.0.

    without_label: leave its label out.
    """
    pack = not raw.startswith(_JSON_STARTS)
    value = msgspec.msgpack.decode(raw) if pack else msgspec.json.decode(raw)
    if without_label:
        del value["label"]
    track = value.get("track")
    if isinstance(track, float) and track.is_integer():
        value["track"] = int(track)
    return msgspec.convert(value, Event)


def stamp_of(line: bytes) -> tuple[str, float] | None:
    """Return camera and time (seconds) in a line of JSON; None for a line without a valid time."""
    try:
        stamp: _Stamp = _json_stamp.decode(line)
    except _UNREADABLE:
        return None
    return (stamp.camera, stamp.t) if T_MIN <= stamp.t < T_MAX else None


def is_json(raw: bytes) -> bool:
    """Return True if this is one value of JSON, whatever its type."""
    try:
        _json_value.decode(raw)
    except _UNREADABLE:
        return False
    return True


def in_words(error: msgspec.ValidationError) -> str:
    """Return the mistake; of a camera's id in words."""
    name = "a camera id: 1 to 64 of the characters A-Z a-z 0-9 _ . -, and not `daemon`"
    return str(error).replace(f"`str` matching regex {CAMERA_PATTERN!r}", name)


def _rejection(error: Exception) -> Rejected:
    if isinstance(error, msgspec.ValidationError):
        return Rejected("bad-value", in_words(error))
    if isinstance(error, UnicodeDecodeError) or str(error) == _NOT_UTF8:
        return Rejected("not-utf8", "text is not UTF-8")
    if isinstance(error, RecursionError):
        return Rejected("too-deep", "nested too deeply")
    mistake = "it is empty, or cut off" if str(error) == _CUT_OFF else str(error)
    return Rejected("malformed", mistake)


def read(kind: type[_T], raw: bytes, pack: bool = False) -> _T:
    """Return a ``kind`` from JSON, or from MessagePack if ``pack``; raise `Rejected`."""
    with _making:
        decoder = _decoder(kind, pack)  # type: ignore[arg-type]  # types are hashable
    try:
        result: _T = decoder.decode(raw)
    except _UNREADABLE as error:
        raise _rejection(error) from None
    return result


@functools.cache
def _decoder(kind: Any, pack: bool) -> Any:
    """Return the decoder of a type, which is made once.

    Only one thread makes a decoder at a time: while msgspec (0.22) examines a type for the first
    time, another thread that decodes the same type crashes the process.
    """
    if pack:
        return msgspec.msgpack.Decoder(kind)
    return msgspec.json.Decoder(kind)


def decode_topology(raw: bytes, pack: bool = False) -> Topology:
    """Return a topology whose references and values are all valid; raise `Rejected`.

    Its users need not check again: each name refers to an item of the topology, and each number is
    in its range.
    """
    topology = read_topology(raw, pack)
    require_sound(topology)
    return topology


def read_topology(raw: bytes, pack: bool = False) -> Topology:
    """Return a topology that this program has written and stored; raise `Rejected`.

    One of an older form (`camtopod.older`) is converted.
    """
    try:
        return read(Topology, raw, pack)
    except Rejected:
        content = read(dict, raw, pack)
        model = content.get("model")
        if not isinstance(model, dict) or "zones" not in model:
            raise
        return _converted(content)


def _converted(content: dict[str, Any]) -> Topology:
    """Return a topology of an older form; raise `Rejected`."""
    try:
        columns = older.with_columns(content)
        return msgspec.convert(columns, Topology)
    except msgspec.ValidationError as error:
        raise _rejection(error) from None
    except (KeyError, TypeError, AttributeError, ArithmeticError, ValueError) as error:
        raise Rejected("bad-value", f"{error} - at `$.model`") from None


def require_sound(topology: Topology) -> None:
    """Raise `Rejected` unless all references and values of a topology are valid."""
    for problem in soundness.problems(topology):
        raise Rejected("bad-value", problem)


def require_topology(topology: object) -> None:
    """Raise TypeError for an argument of another type, such as a file name."""
    if not isinstance(topology, Topology):
        raise TypeError(f"{topology!r:.100} is no topology; load_topology reads one from its file")


def load_topology(path: str | Path) -> Topology:
    """Return the topology of a file that `camtopod learn` has written.

        >>> from camtopod import load_topology
        >>> [pair.cameras for pair in load_topology("topology.json").pairs]
        [('hall', 'lobby')]

    Raises OSError; `Rejected` (a ValueError) if it is not a topology.
    """
    return decode_topology(Path(path).read_bytes())


def to_json(record: Event | Topology | Delta | Prediction | Any) -> bytes:
    """Return a record as JSON on one line, without the newline."""
    return _to_json.encode(record)


def to_msgpack(record: Event | Topology | Delta | Prediction | Any) -> bytes:
    """Return a record as MessagePack."""
    return _to_pack.encode(record)
