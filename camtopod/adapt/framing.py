"""Find the messages in a stream of bytes: by a format's own frames, not by lines.

A message is a JSON object, from ``{`` to its ``}``: on one line, over several, one of several on a
line, or an element of an array. A topic may be in front of it on its line. Of XML it is a document,
to the end of ``MetadataStream``. Anything else is a line, however it ends.

A message that was cut off does not swallow the next: no string of JSON holds the end of a line, and
a line that begins with a member of an object begins a message. Each byte is looked at a few times,
so time grows with the length of the stream alone.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from camtopod import codec

_BOM = b"\xef\xbb\xbf"
_BETWEEN = re.compile(rb"(?:[\s\0\x1e,\[\]]|\xef\xbb\xbf)*+")
"""Bytes between two messages: blanks, marks, and the signs of an array."""
_IN_JSON = re.compile(rb'["{}\[\]\n]')
_IN_STRING = re.compile(rb'["\n]|(?:\\.)++')
_IN_XML = re.compile(rb"[<>]")
_END = re.compile(rb"</(?:[\w.-]+:)?MetadataStream\s*>|<(?:[\w.-]+:)?MetadataStream[^<>]*/>")
"""Tag that ends a document."""
_ROOT = re.compile(rb"<(?:[\w.-]+:)?MetadataStream[\s>]")
"""Tag of a document's root."""


class _Stream:
    """The text of a stream since the beginning of a message."""

    def __init__(self, pieces: Iterable[bytes], bytes_max: int) -> None:
        self.text = bytearray()
        self.number = 1
        """Number of the line in which it begins."""
        self.at_line = True
        """It begins with a line."""
        self.is_new = False
        """Something has come since this was set to False."""
        self._pieces = iter(pieces)
        self._max = bytes_max
        self._ends_in_return = False

    def more(self) -> bool:
        """Wait for the next piece, with ends of lines of all systems; return False at the end."""
        if (piece := next(self._pieces, None)) is None:
            return False
        if self._ends_in_return and piece.startswith(b"\n"):
            piece = piece[1:]
        self._ends_in_return = piece.endswith(b"\r")
        self.is_new = True
        self.text += piece.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        return True

    def drop(self, end: int | None) -> None:
        """Drop the text up to ``end``; None for all."""
        self.number += self.text.count(b"\n", 0, end)
        self.at_line = self.text.endswith(b"\n", 0, end)
        del self.text[:end]

    def search(self, pattern: re.Pattern[bytes], at: int) -> re.Match[bytes] | None:
        """Return the next match as soon as it has come; None at the end, and beyond the limit."""
        while (match := pattern.search(self.text, at)) is None:
            at = max(at, len(self.text) - self.text.endswith(b"\\"))
            if len(self.text) > self._max or not self.more():
                return None
        return match


def frames(
    pieces: Iterable[bytes], bytes_max: int, begins: bytes = b"{"
) -> Iterator[tuple[int, bytes]]:
    """Yield each message as soon as it has come, with the number (from 1) of its first line.

    bytes_max: longest message; a longer one is cut to a byte more.
    begins: ``{`` if messages may be JSON objects, ``<`` if they may be XML documents.
    """
    stream = _Stream(pieces, bytes_max)
    text = stream.text
    begin = re.compile(b"[" + begins + b"\n]")
    while True:
        # Lines that are messages, as they mostly are: all that have come.
        if stream.at_line and stream.is_new and b"{" in begins:
            stream.is_new = False
            size = 0
            for count, line in enumerate(bytes(text[: text.rfind(b"\n") + 1]).split(b"\n")):
                if line[:1] != b"{" or len(line) > bytes_max or not codec.is_json(line):
                    break
                yield stream.number + count, line.strip()
                size += len(line) + 1
            if size:
                stream.drop(size)

        # Skip what stands between.
        if not text.startswith(b"{"):
            if (between := _BETWEEN.match(text)) and between[0]:
                stream.drop(between.end())
            if _BOM.startswith(bytes(text[:3])):  # or nothing
                if not stream.more():
                    return
                continue

        # The message, and nothing of the rest of one that is too long.
        end = _whole_line(text, begin, bytes_max) if stream.at_line else None
        end = end or _end(stream, begin)
        message = bytes(text[: min(end or len(text), bytes_max + 1)]).strip()
        yield stream.number, message
        stream.drop(bytes_max + 1 if end is None else end + text.startswith(b"\n", end))
        if end is None:
            after = b"<" if message.startswith(b"<") and b"<" in begins else b"\n"
            while after not in text:
                stream.drop(None)
                if not stream.more():
                    return
            stream.drop(text.index(after))


def _whole_line(text: bytearray, begin: re.Pattern[bytes], bytes_max: int) -> int | None:
    """Return the end of the line if that is a message of its own, as it mostly is."""
    end = text.find(b"\n", 0, bytes_max + 1)
    match = begin.search(text, 0, end + 1)
    if match is None or match[0] == b"<":
        return None
    if match[0] == b"{" and not codec.is_json(bytes(text[match.start() : end])):
        return None
    return end


def _end(stream: _Stream, begin: re.Pattern[bytes]) -> int | None:
    """Return where the message ends; None at the end of the stream, and beyond the limit."""
    match = stream.search(begin, 0)
    if match is None or match[0] == b"\n":
        return match and match.start()
    if match[0] == b"{":
        return _end_of_json(stream, match.start())
    return match.start() or _end_of_xml(stream)


def _end_of_json(stream: _Stream, at: int) -> int | None:
    brackets = bytearray()  # those that are open
    line_at: int | None = None  # where the line begins, until something of JSON is found in it
    while match := stream.search(_IN_JSON, at):
        at = match.end()
        sign = match[0]
        if sign == b"\n":
            line_at = at
            continue
        if sign == b"{" and line_at is not None and _begins(stream, line_at, at, brackets):
            return line_at
        line_at = None
        if sign == b'"':
            while (match := stream.search(_IN_STRING, at)) and match[0][:1] == b"\\":
                at = match.end()
            if match is None or match[0] == b"\n":
                return match and match.start()
            at = match.end()
        elif sign in b"{[":
            brackets += sign
        else:
            brackets.pop()
            if not brackets:
                return at
    return None


def _begins(stream: _Stream, line_at: int, at: int, brackets: bytearray) -> bool:
    """Return True if the first brace of a line, which ends at ``at``, begins another message."""
    text = stream.text
    before = text[line_at : at - 1]
    if before:  # a topic, or an indentation
        return not before[:1].isspace() and b"," not in before and not before.startswith(b":")
    if at == len(text):
        stream.more()
    if not text.startswith((b"\n", b"}"), at):
        return True
    last = text[max(0, line_at - 64) : line_at].rstrip()
    in_list = last.endswith(b",") and brackets.endswith(b"[")
    return not (last.endswith((b":", b"[")) or in_list)


def _end_of_xml(stream: _Stream) -> int | None:
    at = tag_at = 0
    has_root = False
    while match := stream.search(_IN_XML, at):
        at = match.end()
        if match[0] == b"<":
            tag_at = match.start()
            continue
        tag = bytes(stream.text[tag_at:at])
        if _END.fullmatch(tag):
            return at
        is_root = _ROOT.match(tag) is not None
        if tag_at > 0 and (tag.startswith(b"<?xml") or (is_root and has_root)):
            return tag_at
        has_root |= is_root
        tag_at = at
    return None
