"""What the formats share: how an adapter is spoken to, sizes of pictures, what may be quoted of a
line.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Protocol

from camtopod import codec
from camtopod.codec import Rejected
from camtopod.records import Event

LINE_BYTES_MAX = 1024 * 1024
"""Longer lines are refused. Frigate's grow with the path of an object."""
ANY_CAMERA = ""
"""The key in `Sizes` of the size of all cameras that are not named."""

Size = tuple[int, int]
Sizes = Mapping[str, Size]
"""Width and height in pixels, by camera."""

_STRING = re.compile(rb'("(?:[^"\\]|\\.)*(?:"|$))(\s*:)?')


class Adapter(Protocol):
    """Reads one format, line by line. Raises `Rejected` for a line that changes nothing."""

    topic: str
    """MQTT topic of these lines below the program's prefix; empty if they do not come by MQTT."""

    def receive(self, line: bytes) -> list[Event]:
        """The events that a line makes sure."""

    def close(self) -> list[Event]:
        """The events that are sure when nothing more comes."""


def size_of(camera: str, sizes: Sizes) -> Size:
    """The size of the pictures of ``camera``. Raises `Rejected`."""
    size = sizes.get(camera) or sizes.get(ANY_CAMERA)
    if size is None:
        raise Rejected(
            "no-size", f"the size of the pictures is not known: give --size {camera}=WIDTHxHEIGHT"
        )
    return size


def payload(line: bytes, topic: str) -> bytes:
    """The message in a line of `mosquitto_sub`, with ``-v`` or without. Raises `Rejected` for
    another topic's.
    """
    if line.startswith(b"{"):
        return line
    name, blank, message = line.partition(b" ")
    if not blank:
        raise Rejected("malformed", "is neither JSON nor a topic and JSON")
    levels = name.decode("utf-8", "replace").split("/")
    wanted = topic.split("/")
    tail = levels[-len(wanted) :]
    if len(tail) < len(wanted) or any(
        want not in ("+", got) for want, got in zip(wanted, tail, strict=True)
    ):
        raise Rejected("other-topic", f"is not of .../{topic}")
    return message


def checked(events: Iterable[Event]) -> list[Event]:
    """The events as if they had come by themselves: what is in them is the other program's. Raises
    `Rejected`.
    """
    return [codec.event_from_json(codec.to_json(event)) for event in events]


def quotable(line: bytes) -> bytes:
    """The form of a line without the text in it: what other programs say may name people."""
    if line.startswith(b"{"):
        return _STRING.sub(lambda found: found[0] if found[2] else b'"..."', line)
    word, blank, _ = line.partition(b" ")
    shown = word if b"/" in word or b"," in word else b"..."  # a topic, numbers
    return shown + blank + b"..." if blank else shown
