"""Rows of a table as event lines: names of columns, numbers, dates and names of cameras.

The table may come from a text, a spreadsheet or a file of columns.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from datetime import UTC, date, datetime, time

from camtopod.adapt import folded
from camtopod.cli.exits import InputError
from camtopod.codec import Rejected, to_json
from camtopod.event_time import seconds_of_text

COLUMNS = ("camera", "kind", "t")
"""Columns that a table of events must have."""
NAMES_CHARACTERS_MAX = 300
"""Most characters of the columns' names in a message."""
_MISSING = frozenset(
    {"", "NA", "N/A", "#N/A", "<NA>", "nan", "NaN", "NAN", "NaT", "null", "NULL", "None"}
    | {"\\N", "(null)"}
)
"""Cells without a value, as R, pandas, spreadsheets and databases write them."""
_WHOLE = re.compile(r"([0-9]+)[.,]0+")
"""A whole number that was written as a float."""
_ZONED = re.compile(r"[T :].*([zZ]|UTC|GMT|[+-][0-9]{2}(:?[0-9]{2})?) *\Z")
"""A date with a time of day and a time zone."""
_DECIMAL_COMMA = re.compile(r"[-+]?[0-9]+,[0-9]+(?:[eE][-+]?[0-9]+)?")


class Rows:
    """Makes a line of JSON of each row of a table.

    path: of the table, for messages.
    names: of the columns, whatever their case.
    needed: columns without which this is no such table.

    Raises `InputError` if one of these is missing.
    """

    def __init__(self, path: str, names: Sequence[str], needed: Sequence[str] = COLUMNS) -> None:
        plain = [plain_name(name) for name in names]
        if missing := [name for name in needed if name not in plain]:
            there = ", ".join(name.strip() for name in names)[:NAMES_CHARACTERS_MAX]
            has_none = any(isinstance(number(name), float) for name in plain)
            raise InputError(
                f"{path}: the header has no column {' and no '.join(missing)}: its columns are "
                f"{there}; rename those that are meant{', or put a header above' * has_none}"
            )
        self.count = len(names)
        """Number of columns."""
        self._cameras: dict[str, str] = {}
        self._names: dict[str, str] = {}
        self._has_zone: bool | None = None
        """Whether the dates have a time zone; None before the first one."""
        makers: dict[str, Callable[[str], object]] = {
            "camera": self._camera,
            "kind": str.lower,
            "t": self._seconds,
            "track": name_of,
            "boot": name_of,
            "seq": _count,
            **dict.fromkeys(("x", "y", "clock_sd"), number),
            "label": str,
            **dict.fromkeys(("identity", "district"), name_of),
        }
        self._columns = [
            (index, name, makers[name])
            for index, name in enumerate(plain)
            if name in makers and name not in plain[:index]
        ]

    def line(self, cells: Sequence[object]) -> bytes | Rejected | None:
        """Return a row as a line of JSON; None for one without values."""
        if len(cells) > self.count:
            return Rejected(
                "too-long",
                f"{len(cells)} cells below {self.count} columns: decimal commas, names of rows, or "
                "separators at the end?",
            )
        values: dict[str, object] = {}
        try:
            for index, name, make in self._columns[: len(cells)]:
                if index < len(cells) and (text := text_of(cells[index])) not in _MISSING:
                    values[name] = make(text)
        except Rejected as error:
            return error
        return to_json(values) if values else None

    def _seconds(self, text: str) -> object:
        """Return seconds since 1970, of a number or of ISO 8601, UTC without a zone.

        A text that is neither stays one. Raises `Rejected` for a date with a time zone among others
        without.
        """
        value = number(text)
        if isinstance(value, float):
            return value
        try:
            value = seconds_of_text(text)
        except (ValueError, OverflowError):
            return text
        has_zone = _ZONED.search(text) is not None
        if self._has_zone not in (None, has_zone):
            words = ("no time zone", "those before have one")
            if has_zone:
                words = ("a time zone", "those before have none")
            raise Rejected(
                "time-zone", f"t has {words[0]}, while {words[1]}: write it at all - at `$.t`"
            )
        self._has_zone = has_zone
        return value

    def _camera(self, name: str) -> str:
        """Return the id of a camera; raise `Rejected` if another one has it."""
        name = name_of(name)
        camera = self._cameras.get(name)
        if camera is None:
            camera = self._cameras[name] = folded(name)
        first = self._names.setdefault(camera, name)
        if first != name:
            raise Rejected(
                "same-camera", f"cameras {first[:64]!r} and {name[:64]!r} would both be {camera}"
            )
        return camera


def plain_name(name: str) -> str:
    """Return the name of a column in small letters, without quotation marks."""
    return name.strip(" \t\r\"'#\ufeff").lower()


def count_needed(names: Sequence[str], needed: Sequence[str]) -> int:
    """Return the number of the columns that are needed among those of these names."""
    return len({*needed}.intersection(map(plain_name, names)))


def text_of(cell: object) -> str:
    """Return the text of a cell; of a moment its seconds since 1970, UTC without a zone."""
    if isinstance(cell, str):
        return cell.strip()
    if cell is None:
        return ""
    if isinstance(cell, bytes):
        return cell.decode("utf-8", "replace")
    if isinstance(cell, date):
        moment = cell if isinstance(cell, datetime) else datetime.combine(cell, time())
        return repr((moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp())
    return str(cell)


def number(text: str) -> object:
    """Return a number, with a decimal point or comma; a text that is none stays one."""
    try:
        value = float(text)
    except ValueError:
        if _DECIMAL_COMMA.fullmatch(text) is None:
            return text
        value = float(text.replace(",", "."))
    return value if math.isfinite(value) else text


def name_of(text: str) -> str:
    """Return a name; a whole number that was written as a float is one without the point."""
    match = _WHOLE.fullmatch(text)
    return match[1] if match else text


def _count(text: str) -> object:
    text = name_of(text)
    return int(text) if text.isdecimal() and len(text) < 20 else number(text)
