"""Common part of the formats: the base of all adapters, topics, picture sizes."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from fnmatch import fnmatchcase
from typing import Any

from msgspec import Raw, Struct

from camtopod import codec
from camtopod.adapt.camera_names import CameraNames
from camtopod.codec import Rejected
from camtopod.records import Event

LINE_BYTES_MAX = 1024 * 1024
"""Longest accepted line, bytes. Frigate's lines grow with the path of an object."""
KINDS_SHOWN_MAX = 5
"""Most kinds of objects that a message names."""
REMEMBERED_MAX = 10_000
"""Objects remembered, the latest ones, so that a repeated message counts once."""
OUTSIDE_MAX = 0.1
"""Largest distance of a foot point from the picture, in fractions of it: boxes are inexact."""
OUTSIDE_BOXES = 20
"""Boxes of a camera that cannot be right after which that is said: a few may be errors."""
BEYOND_SHARE = 1 / 3
"""Share of a camera's boxes that are wrong from which they are no errors of single boxes."""
UNWANTED_OBJECTS = 100
"""Objects of which none counts, by ``--label``, after which that is said."""
ANY_CAMERA = ""
"""Key in `Sizes` for all cameras that are not named."""

Size = tuple[int, int]
"""Width and height of a picture, pixels."""
Sizes = Mapping[str, Size]
"""Width and height of the pictures in pixels, by camera."""

_MESSAGE = re.compile(
    rb"(?:[\d:.,TZ+-]+[ \t]+(?=[^{<\s]))*+"
    rb"(?:(?:([^{<]*)[ \t])?([{<].*)|([^\s{<]*/[^\s{<]*)[ \t].*)",
    re.DOTALL,
)
"""A JSON or XML message, and the topic (or the key of a queue) in front of it; or the topic of a
message in another form. Before the topic may be the time at which the message came.
"""


class _Envelope(Struct):
    """A message as MQTT clients log it: in JSON, beside its topic."""

    topic: Any = None
    payload: Raw = Raw()


class Adapter:
    """Converter of one format, message by message: a line, or what `framing` finds."""

    topic = "#"
    """MQTT topic of these lines below the program's prefix."""
    begins = b"{"
    """Signs that begin a message, as for `framing.frames`; without any, each line is one."""
    outside_cause = "is --size right?"
    """Likely cause of boxes outside the picture, as a message."""
    box_form = "left, top, right, bottom in pixels"
    """Meaning of the numbers of a box."""

    def __init__(self, camera: str | None = None) -> None:
        self.cameras = CameraNames(camera)
        self.say: Callable[[str], None] = lambda note: None
        """Tells the user something; set by the caller."""
        self.boxes_used = self.boxes_unused = 0
        """Boxes of the whole input, known after `close`."""
        self._noted: set[tuple[str, str]] = set()
        """Remarks that were logged, with their cameras."""

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

    def _check_boxes(self, camera: str, counts: Mapping[str, int], is_end: bool = False) -> None:
        """Note it once if many boxes of a camera cannot be right; at the end, if any cannot.

        counts: as `TrackEvents.statistics`.
        """
        outside, unusable, beyond = (counts[name] for name in ("outside", "unusable", "beyond"))
        if is_end:
            trackless = 0 if counts["used"] else counts["untracked"]
            self.boxes_used += counts["used"]
            self.boxes_unused += outside + unusable + trackless
            if trackless:
                self._note(camera, f"{trackless} boxes have no track, and none is used")
        if outside >= OUTSIDE_BOXES:
            self._note(
                camera,
                f"{outside} boxes lie outside the picture and are not used: {self.outside_cause}",
            )
        if unusable >= (1 if is_end else OUTSIDE_BOXES):
            self._note(
                camera,
                f"{unusable} boxes have no area, or less than a pixel, and are not used: are they "
                f"{self.box_form}?",
            )
        if beyond >= max(OUTSIDE_BOXES, BEYOND_SHARE * counts["used"]):
            self._note(
                camera,
                f"{beyond} of {counts['used']} boxes reach far beyond the picture: "
                f"{self.outside_cause} Are they {self.box_form}?",
            )

    def _check_kinds(
        self, object_count: int, unwanted: Mapping[str, int], is_end: bool = False
    ) -> None:
        """Note it once if no object counts, by ``--label``.

        object_count: objects that count.
        unwanted: the others, by kind.
        """
        total = sum(unwanted.values())
        if object_count or total < (1 if is_end else UNWANTED_OBJECTS):
            return
        kinds = sorted(unwanted, key=lambda kind: -unwanted[kind])[:KINDS_SHOWN_MAX]
        words = ", ".join(f"{unwanted[kind]} {kind or 'without a kind'}" for kind in kinds)
        self._note("", f"of {total} objects none counts by --label: {words}")

    def _note(self, camera: str, message: str) -> None:
        """Log a remark once for each camera; the text after its numbers tells remarks apart."""
        key = camera, re.sub("[0-9]+", "", message).split(":")[0]
        if key not in self._noted:
            self._noted.add(key)
            self.say(f"camera {camera}: {message}" if camera else message)


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
    topic, message = "", None
    if match is not None:
        topic = (match[1] or match[3] or b"").decode("utf-8", "replace").strip()
        message = match[2]
    if message is not None and b'"payload"' in message:
        envelope = codec.read(_Envelope, message)
        if envelope.topic and (content := bytes(envelope.payload)):
            topic = str(envelope.topic)
            message = codec.read(str, content).encode() if content.startswith(b'"') else content
    if topic and not fnmatchcase(topic, pattern):
        raise Rejected("other-topic", f"is not of {pattern}")
    if message is None:
        raise Rejected("malformed", "is neither a message nor a topic and a message")
    return topic.split("/") if topic else [], message


def remember(latest: dict[Any, Any], key: object, value: object) -> None:
    """Put an item last, and forget the first ones beyond `REMEMBERED_MAX`."""
    latest.pop(key, None)
    latest[key] = value
    while len(latest) > REMEMBERED_MAX:
        del latest[next(iter(latest))]
