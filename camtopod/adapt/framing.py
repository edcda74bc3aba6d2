"""Find the messages in a stream of bytes: by a format's own frames, not by lines.

A message is a JSON object, from ``{`` to its ``}``: on one line, over several, one of several on a
line, or an element of an array. A topic may be in front of it on its line. Of XML it is a document,
to the end of ``MetadataStream``. Anything else is a line, however it ends.

What was cut off does not swallow what follows: no string of JSON holds the end of a line, and a
line that begins with a member of an object begins a message.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from msgspec import Raw

from camtopod import codec

_BOM = b"\xef\xbb\xbf"
_BETWEEN = re.compile(rb"(?:[\s\0\x1e,\[\]]|\xef\xbb\xbf)*+")
"""What may stand between two messages: blanks, marks, and the signs of an array."""
_STRING = re.compile(rb'[^"\\\n]*+(?:\\[^\n][^"\\\n]*+)*+')
"""The inside of a string of JSON."""
_IN_JSON = re.compile(rb'["{}\[\]\n]')
_IN_XML = re.compile(rb"[<>]")
_END = re.compile(rb"</(?:[\w.-]+:)?MetadataStream\s*>|<(?:[\w.-]+:)?MetadataStream[^<>]*/>")
"""Tag that ends a document."""
_ROOT = re.compile(rb"<(?:[\w.-]+:)?MetadataStream[\s>]")
"""Tag of a document's root."""
_UNKNOWN = -1

Frame = tuple[int, bytes]
"""Number of the line in which a message begins, from 1, and the message."""


class Frames:
    """The messages of one stream. Time grows with its length, memory with ``bytes_max``.

    bytes_max: longest message; a longer one is cut to a byte more.
    begins: ``{`` if messages may be JSON objects, ``<`` if they may be XML documents.
    """

    def __init__(self, bytes_max: int, begins: bytes = b"{") -> None:
        self._max = bytes_max
        self._begins = re.compile(b"[" + begins + b"\n]")
        self._text = bytearray()
        """What has come since the beginning of the message."""
        self._line = 1
        """Number of the line in which it begins."""
        self.is_new = True
        """Nothing has come yet."""
        self._return = False
        self._new_line = True
        self._at = 0
        """Up to where the text was looked at; this and other places count from its beginning."""
        self._begin()

    def feed(self, piece: bytes) -> Iterator[Frame]:
        """Yield the messages that end in the next piece of the stream."""
        # Ends of lines, of all systems.
        self.is_new = False
        if self._return and piece.startswith(b"\n"):
            piece = piece[1:]
        self._return = piece.endswith(b"\r")
        if b"\r" in piece:
            piece = piece.replace(b"\r\n", b"\n").replace(b"\r", b"\n")

        self._text += piece
        while self._began or self._find_begin():
            if (end := self._find_end()) is None:
                break
            yield from self._cut(end)
            self._begin()

        # Of a message that is too long, no more than the limit is kept.
        if self._at > self._max:
            yield from self._cut(self._at)
            self._is_cut = True
            self._new_line = False

    def end(self) -> Iterator[Frame]:
        """Yield what the stream's end has cut off."""
        yield from self._cut(len(self._text))

    def _begin(self) -> None:
        """Prepare for the next message."""
        self._began = False
        self._is_cut = False
        self._at = 0
        self._open = bytearray()
        """The brackets that are open."""
        self._in_string = False
        self._line_at: int | None = None
        """Where the line begins, until something of JSON was found in it."""
        self._tag_at: int | None = None
        """Where a tag of XML begins."""
        self._in_xml = False
        self._in_root = False

    def _cut(self, end: int) -> Iterator[Frame]:
        """Take the text up to ``end``; yield it, unless its beginning was yielded before."""
        frame = bytes(self._text[: min(end, self._max + 1)]).strip()
        if frame and not self._is_cut:
            yield self._line, frame
        self._new_line = self._text[max(0, end - 1) : end] == b"\n"
        self._line += self._text.count(b"\n", 0, end)
        del self._text[:end]
        self._at = 0
        self._line_at = self._tag_at = None

    def _find_begin(self) -> bool:
        """Move to the beginning of a message; return False if there is none yet."""
        between = _BETWEEN.match(self._text)
        assert between is not None
        if end := between.end():
            lines = self._text.count(b"\n", 0, end)
            self._line += lines
            self._new_line |= lines > 0
            del self._text[:end]
        self._began = bool(self._text) and not _BOM.startswith(bytes(self._text[:3]))
        return self._began

    def _find_end(self) -> int | None:
        """Return where the message ends; None if that has not come yet."""
        if self._new_line:
            self._new_line = False
            if (end := self._whole_line()) is not None:
                return end
        while self._at < len(self._text):
            if self._in_string:
                end = self._step_in_string()
            elif self._open:
                end = self._step_in_json()
            elif self._in_xml:
                end = self._step_in_xml()
            else:
                end = self._step_in_line()
            if end is not None:
                return None if end == _UNKNOWN else end
        return None

    def _whole_line(self) -> int | None:
        """Return the end of the line if that is a message of its own, as it mostly is."""
        end = self._text.find(b"\n", 0, self._max + 1)
        found = self._begins.search(self._text, 0, end + 1)
        if end < 0 or found is None or found[0] == b"<":
            return None
        try:
            if found[0] == b"{":
                codec.read(Raw, bytes(self._text[found.start() : end]))
        except codec.Rejected:
            return None
        return end

    # Each step looks at the text up to the next sign that matters. It returns the end of the
    # message, `_UNKNOWN` if that depends on what comes next, or None.

    def _step_in_line(self) -> int | None:
        found = self._begins.search(self._text, self._at)
        if found is None:
            self._at = len(self._text)
            return None
        self._at = found.end()
        if found[0] == b"{":
            self._open += b"{"
            return None
        if found[0] == b"<" and found.start() == 0:
            self._in_xml = True
            self._tag_at = 0
            return None
        return found.start()

    def _step_in_json(self) -> int | None:
        found = _IN_JSON.search(self._text, self._at)
        if found is None:
            self._at = len(self._text)
            return None
        start, sign = found.start(), found[0]
        if sign == b"\n":
            self._at = self._line_at = found.end()
            return None
        if sign == b"{" and self._line_at is not None:
            if start + 1 == len(self._text):
                self._at = start
                return _UNKNOWN
            if self._begins_message(self._line_at, start):
                return self._line_at
        self._at = found.end()
        self._line_at = None
        if sign == b'"':
            self._in_string = True
        elif sign in b"{[":
            if len(self._open) <= self._max:
                self._open += sign
        else:
            self._open.pop()
            if not self._open:
                return self._at
        return None

    def _begins_message(self, line_at: int, brace: int) -> bool:
        """Return True if the first brace of a line begins a message, and not a part of this one."""
        before = self._text[line_at:brace]
        if before:  # a topic, or an indentation
            return not before[:1].isspace() and b"," not in before and b":" not in before[:1]
        if not self._text.startswith((b"\n", b"}"), brace + 1):
            return True
        last = self._text[max(0, line_at - 64) : line_at].rstrip()
        in_list = last.endswith(b",") and self._open.endswith(b"[")
        return not (last.endswith((b":", b"[")) or in_list)

    def _step_in_string(self) -> int | None:
        inside = _STRING.match(self._text, self._at)
        assert inside is not None
        self._at = end = inside.end()
        following = self._text[end : end + 2]
        if following[:1] == b'"':
            self._at += 1
            self._in_string = False
            return None
        if following[:1] == b"\n":
            return end
        return end + 1 if following == b"\\\n" else _UNKNOWN

    def _step_in_xml(self) -> int | None:
        found = _IN_XML.search(self._text, self._at)
        if found is None:
            self._at = len(self._text)
            return None
        self._at = found.end()
        if found[0] == b"<":
            self._tag_at = found.start()
            return None
        if self._tag_at is None:
            return None
        start = self._tag_at
        tag = self._text[start : self._at]
        self._tag_at = None
        if _END.fullmatch(tag):
            return self._at
        is_root = _ROOT.match(tag) is not None
        if start > 0 and (tag.startswith(b"<?xml") or (is_root and self._in_root)):
            return start
        self._in_root |= is_root
        return None


def messages_in(content: bytes, bytes_max: int, begins: bytes) -> list[bytes]:
    """Return the messages in something that has come whole; arguments are those of `Frames`."""
    frames = Frames(bytes_max, begins)
    return [message for _, message in [*frames.feed(content + b"\n"), *frames.end()]]
