"""Event lines of a table: CSV with a header, as pandas and spreadsheets write it."""

from __future__ import annotations

import contextlib
import csv
import json
import re
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime

from camtopod.cli.exits import InputError

COLUMNS = ("camera", "kind", "t")
"""Columns that a table of events must have."""
LINE_BYTES_MAX = 100_000
"""Longest line, in bytes."""
_NUMBERS = ("t", "x", "y", "seq", "clock_sd")
_DELIMITER = re.compile(r"[,;\t]")


def is_table(beginning: bytes) -> bool:
    """Return True if a file that begins like this has a header: two of `COLUMNS` at least."""
    header = beginning.split(b"\n", 1)[0].decode("utf-8-sig", "replace")
    names = {name.strip(' "\r') for name in _DELIMITER.split(header)}
    return "{" not in header and len(names.intersection(COLUMNS)) > 1


def rows(pieces: Iterable[bytes], path: str) -> Iterator[tuple[int, bytes]]:
    """Yield each row of a table as a line of JSON, with the number (from 1) of its line.

    ``t`` is seconds since 1970 or ISO 8601, which is UTC if it has no time zone. Empty cells are
    left out. Raises `InputError` if a column is missing.
    """
    lines = _lines(pieces, path)
    header = next(lines)
    delimiter = _DELIMITER.findall(header)[0]
    names = [name.strip() for name in next(csv.reader([header], delimiter=delimiter))]
    if missing_columns := [name for name in COLUMNS if name not in names]:
        raise InputError(f"{path}: the header has no column {' and no '.join(missing_columns)}")

    reader = csv.reader(lines, delimiter=delimiter)
    try:
        for row in reader:
            cells = {name: cell for name, cell in zip(names, row, strict=False) if cell.strip()}
            if cells:
                line = {name: _value(name, cell.strip()) for name, cell in cells.items()}
                yield reader.line_num + 1, json.dumps(line).encode()
    except csv.Error as error:
        raise InputError(f"{path}:{reader.line_num + 1}: {error}") from None


def _lines(pieces: Iterable[bytes], path: str) -> Iterator[str]:
    """Yield the lines of a text, without the mark at its beginning."""
    remainder = b""
    for piece in pieces:
        *whole, remainder = (remainder + piece).split(b"\n")
        if len(remainder) > LINE_BYTES_MAX:
            raise InputError(f"{path} has a line of more than {LINE_BYTES_MAX} bytes")
        yield from (line.decode("utf-8-sig", "surrogateescape") for line in whole)
    yield remainder.decode("utf-8-sig", "surrogateescape")


def _value(name: str, cell: str) -> str | float:
    """Return a cell's value; a text that is no number stays one, and is rejected as such."""
    if name not in _NUMBERS:
        return cell
    for number in (int, float):
        with contextlib.suppress(ValueError):
            return number(cell)
    with contextlib.suppress(ValueError):
        t = datetime.fromisoformat(cell)
        return (t if t.tzinfo else t.replace(tzinfo=UTC)).timestamp()
    return cell
