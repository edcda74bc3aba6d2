"""Common part of the formats: the adapter interface, picture sizes, redaction of quoted lines."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Protocol, TypeVar

from camtopod import codec
from camtopod.codec import Rejected
from camtopod.records import Event

LINE_BYTES_MAX = 1024 * 1024
"""Longest accepted line, bytes. Frigate's lines grow with the path of an object."""
REMEMBERED_MAX = 10_000
"""Objects remembered, the latest ones, so that a repeated message counts once."""
ANY_CAMERA = ""
"""Key in `Sizes` for all cameras that are not named."""

Size = tuple[int, int]
"""Width and height of a picture, pixels."""
Sizes = Mapping[str, Size]
"""Width and height of the pictures in pixels, by camera."""

_K = TypeVar("_K")
_V = TypeVar("_V")
_STRING = re.compile(rb'("(?:[^"\\]|\\.)*(?:"|$))(\s*:)?')
"""A JSON string, and the colon after it if it is a key."""
_XML_TEXT = re.compile(rb"\"[^\"]*\"?|'[^']*'?|(?<=>)[^<]+")
"""A value of an attribute, or text between tags."""


class Adapter(Protocol):
    """Converter of one format, line by line."""

    topic: str
    """MQTT topic of these lines below the program's prefix; empty if they do not come by MQTT."""

    def receive(self, line: bytes) -> list[Event]:
        """Return the events that a line makes certain. Raises `Rejected` for an unusable line."""

    def close(self) -> list[Event]:
        """Return the events that are certain once no more lines come."""


def size_of(camera: str, sizes: Sizes) -> Size:
    """Return the size of the pictures of ``camera``. Raises `Rejected` if it is unknown."""
    size = sizes.get(camera) or sizes.get(ANY_CAMERA)
    if size is None:
        raise Rejected(
            "no-size", f"the size of the pictures is unknown: give --size {camera}=WIDTHxHEIGHT"
        )
    return size


def payload(line: bytes, topic: str) -> bytes:
    """Return the message in a line of `mosquitto_sub`, with or without ``-v`` (topic in front).

    Raises `Rejected` if the topic is another one.
    """
    if line.startswith(b"{"):
        return line
    name, blank, message = line.partition(b" ")
    if not blank:
        raise Rejected("malformed", "is neither JSON nor a topic and JSON")

    # The topic must end with the wanted levels, where "+" stands for any.
    levels = name.decode("utf-8", "replace").split("/")
    wanted = topic.split("/")
    tail = levels[-len(wanted) :]
    if len(tail) < len(wanted) or any(
        want not in ("+", got) for want, got in zip(wanted, tail, strict=True)
    ):
        raise Rejected("other-topic", f"is not of .../{topic}")
    return message


def checked(events: Iterable[Event]) -> list[Event]:
    """Validate events made from another program's data as if they had been received.

    Raises `Rejected`.
    """
    return [codec.event_from_json(codec.to_json(event)) for event in events]


def remember(latest: dict[_K, _V], key: _K, value: _V, most: int) -> None:
    """Put an item last, and forget the first ones beyond ``most``."""
    latest.pop(key, None)
    latest[key] = value
    while len(latest) > most:
        del latest[next(iter(latest))]


def quotable(line: bytes) -> bytes:
    """Return a line without its strings, which may contain names of people.

    What remains shows its form.
    """
    if line.startswith(b"{"):
        return _STRING.sub(lambda found: found[0] if found[2] else b'"..."', line)
    if line.startswith(b"<"):
        return _XML_TEXT.sub(b'"..."', line)
    word, blank, _ = line.partition(b" ")
    shown = word if b"/" in word or b"," in word else b"..."  # a topic, numbers
    return shown + blank + b"..." if blank else shown
