"""Tables as text: CSV and its relatives, as pandas, R, spreadsheets and databases write them.

A row is a line: one stray quotation mark costs one row.
"""

from __future__ import annotations

import csv
import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from camtopod.cli.events.table_rows import COLUMNS, Rows, count_needed, plain_name
from camtopod.codec import Rejected

LINE_BYTES_MAX = 100_000
"""Longest line, in bytes."""
BEGINNING_BYTES_MAX = 1 << 16
"""Bytes within which the header comes."""
_DELIMITERS = ",;\t| "
_SEPARATOR = re.compile(r"\ufeff?sep=(.)", re.IGNORECASE)
"""First line with the delimiter, as Excel reads it."""
_CONTENT = re.compile(rb"[0-9A-Za-z\x80-\xff]")
"""Sign of a row: rules between the rows of a printed table have none."""
_MESSAGE = re.compile(rb"[{<]")
"""Sign of a message: a file with such a one is a table only if its header has the right names."""


class TableHeader(NamedTuple):
    """The header of a table."""

    line: int
    """Number of its line, from 0."""
    names: list[str]
    delimiter: str


def is_told(beginning: bytes) -> bool:
    """Return True if it can be told whether a file that begins like this is a table."""
    return (
        len(_contents(_text_lines(beginning)[:-1])) > 1
        or len(beginning) > BEGINNING_BYTES_MAX
        or beginning.lstrip()[:1] in (b"{", b"[", b"<")
    )


def header_of(beginning: bytes, needed: Sequence[str] = COLUMNS) -> TableHeader | None:
    """Return the header of a file that begins like this; None if it is no table.

    The header has two of the columns that are needed at least or, as these may have other names, as
    many as the line that follows. What stands before it is not read.
    """
    lines = _contents(_text_lines(beginning))
    delimiters = _DELIMITERS
    if lines and (match := _SEPARATOR.fullmatch(lines[0][1])) is not None:
        delimiters = match[1]
        lines = lines[1:]
    before_messages = itertools.takewhile(lambda line: "{" not in line[1], lines)
    headers = [
        TableHeader(number, _cells(text.lstrip("#"), delimiter), delimiter)
        for number, text in before_messages
        for delimiter in delimiters
    ]

    best = max(headers, key=lambda header: count_needed(header.names, needed), default=None)
    if best is not None and count_needed(best.names, needed) > 1:
        return best
    if _MESSAGE.search(beginning) is not None:
        return None
    for header in headers[: len(delimiters)]:
        counts = {len(_cells(text, header.delimiter)) for _, text in lines[:2]}
        if header.delimiter != " " and len(counts) == 1 and counts != {1}:
            return header
    return None


def rows(
    pieces: Iterable[bytes], path: str, header: TableHeader, needed: Sequence[str] = COLUMNS
) -> Iterator[tuple[int, bytes | Rejected]]:
    """Yield each row of a table as a line of JSON, with the number (from 1) of its line.

    ``t`` is seconds since 1970 or ISO 8601, which is UTC if it has no time zone. Empty cells are
    left out. Another header, as of tables that were joined, counts for the rows below it. Raises
    `InputError` if a column is missing.
    """
    table = Rows(path, header.names, needed)
    delimiter = header.delimiter
    for number, (raw, has_end) in enumerate(_lines(pieces)):
        if number <= header.line or raw.startswith(b"#") or _CONTENT.search(raw) is None:
            continue
        if len(raw) > LINE_BYTES_MAX:
            yield number + 1, Rejected("too-long", f"more than {LINE_BYTES_MAX} bytes")
            continue
        try:
            text = raw.decode()
        except UnicodeDecodeError:
            text = raw.decode("cp1252", "replace")
        if needed[1] in text.lower() and (next_header := _complete_header(raw, needed)) is not None:
            table, delimiter = Rows(path, next_header.names, needed), next_header.delimiter
            continue
        cells = (
            _cells(text, delimiter) if b'"' in raw or delimiter == " " else text.split(delimiter)
        )
        if not has_end and len(cells) < table.count:
            yield number + 1, Rejected("malformed", "it is cut off")
        elif (line := table.line(cells)) is not None:
            yield number + 1, line


def _complete_header(line: bytes, columns: Sequence[str]) -> TableHeader | None:
    """Return the header that a line is; None if it lacks one of the columns."""
    header = header_of(line, columns)
    is_complete = header is not None and count_needed(header.names, columns) == len(columns)
    return header if is_complete else None


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        line = line.strip()
    return next(csv.reader([line], delimiter=delimiter, skipinitialspace=delimiter == " "), [])


def _text_lines(beginning: bytes) -> list[str]:
    text = beginning.decode("utf-8", "replace").removeprefix("\ufeff")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _contents(lines: list[str]) -> list[tuple[int, str]]:
    """Return the lines with something in them that may be the header, with their numbers."""
    return [
        (number, line)
        for number, line in enumerate(lines)
        if line.strip()
        and (not line.startswith("#") or {*COLUMNS} <= {*map(plain_name, re.split(r"\W+", line))})
    ]


def _lines(pieces: Iterable[bytes]) -> Iterator[tuple[bytes, bool]]:
    """Yield the lines of a text, which end as on any system, and if they end; long ones are cut."""
    remainder = b""
    for piece in pieces:
        text = remainder + piece
        end = len(text) - text.endswith(b"\r")  # a line feed may follow
        tail = text[end:]
        *whole, remainder = text[:end].replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        remainder = remainder[: LINE_BYTES_MAX + 1] + tail
        yield from ((line, True) for line in whole)
    yield remainder.rstrip(b"\r"), remainder.endswith(b"\r")
