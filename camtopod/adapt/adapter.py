"""Common part of the formats: the base of all adapters, topics, picture sizes."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from fnmatch import fnmatchcase
from typing import Any

from camtopod.adapt.camera_names import CameraNames
from camtopod.codec import Rejected
from camtopod.records import Event

LINE_BYTES_MAX = 1024 * 1024
"""Longest accepted line, bytes. Frigate's lines grow with the path of an object."""
REMEMBERED_MAX = 10_000
"""Objects remembered, the latest ones, so that a repeated message counts once."""
OUTSIDE_MAX = 0.1
"""Largest distance of a foot point from the picture, in fractions of it: boxes are inexact."""
OUTSIDE_BOXES = 20
"""Boxes of a camera outside its picture after which that is said: a few may be errors."""
ANY_CAMERA = ""
"""Key in `Sizes` for all cameras that are not named."""

Size = tuple[int, int]
"""Width and height of a picture, pixels."""
Sizes = Mapping[str, Size]
"""Width and height of the pictures in pixels, by camera."""

_MESSAGE = re.compile(rb"(?:([^{<]*)[ \t])?([{<].*)", re.DOTALL)
"""A JSON or XML message, and the topic (or the key of a queue) in front of it."""


class Adapter:
    """Converter of one format, message by message: a line, or what `framing` finds."""

    topic = "#"
    """MQTT topic of these lines below the program's prefix."""
    begins = b"{"
    """Signs that begin a message, as for `framing.frames`; without any, each line is one."""
    outside_cause = "is --size right?"
    """Likely cause of boxes outside the picture, as a message."""

    def __init__(self, camera: str | None = None) -> None:
        self.cameras = CameraNames(camera)
        self.say: Callable[[str], None] = lambda note: None
        """Tells the user something; set by the caller."""
        self._outside: set[str] = set()

    def receive(self, line: bytes) -> list[Event]:
        """Return the events that a line makes certain. Raises `Rejected` for an unusable line.

        The caller checks the events like those that programs send.
        """
        raise NotImplementedError

    def silent(self, now: float) -> list[Event]:
        """Return the exits in cameras from which nothing has come for too long.

        now: seconds of a clock that runs evenly. To be called before each line that comes live, and
        often in between. Without calls no camera counts as silent.
        """
        return []

    def close(self) -> list[Event]:
        """Return the events that are certain once no more lines come."""
        return []

    def _check_places(self, camera: str, outside: int) -> None:
        """Note it once if many boxes of a camera lie outside its picture."""
        if outside >= OUTSIDE_BOXES and camera not in self._outside:
            self._outside.add(camera)
            self.say(
                f"camera {camera}: {outside} boxes lie outside the picture and are not used: "
                f"{self.outside_cause}"
            )


def size_of(camera: str, sizes: Sizes) -> Size:
    """Return the size of the pictures of ``camera``. Raises `Rejected` if it is unknown."""
    size = sizes.get(camera) or sizes.get(ANY_CAMERA)
    if size is None:
        raise Rejected(
            "no-size", f"the size of the pictures is unknown: give --size {camera}=WIDTHxHEIGHT"
        )
    return size


def split_topic(line: bytes, pattern: str = "*") -> tuple[list[str], bytes]:
    """Return the levels of the topic in front of a message (none if it has none), and the message.

    pattern: pattern of the topic, where ``*`` stands for anything.

    Raises `Rejected` if there is no message, or one of another topic.
    """
    match = _MESSAGE.fullmatch(line)
    if match is None:
        raise Rejected("malformed", "is neither a message nor a topic and a message")
    if match[1] is None:
        return [], match[2]
    topic = match[1].decode("utf-8", "replace").strip()
    if not fnmatchcase(topic, pattern):
        raise Rejected("other-topic", f"is not of {pattern}")
    return topic.split("/"), match[2]


def remember(latest: dict[Any, Any], key: object, value: object) -> None:
    """Put an item last, and forget the first ones beyond `REMEMBERED_MAX`."""
    latest.pop(key, None)
    latest[key] = value
    while len(latest) > REMEMBERED_MAX:
        del latest[next(iter(latest))]
