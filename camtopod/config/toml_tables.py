"""Make structs of TOML, collecting all mistakes with their lines, not only the first.

The standard library's parser does not tell on which line a key is; `key_lines` does.
"""

from __future__ import annotations

import contextlib
import difflib
import re
import tomllib
from collections.abc import Iterator
from typing import Any, NamedTuple, TypeVar

import msgspec
from msgspec import Struct

from camtopod.vision.settings import Areas, Places

FLOAT_MAX = 9e9
"""Largest number that a setting may have.

No operating system waits for longer, in seconds, and as a time it is in 2255.
"""
_GONE_NAMES = """
    ack_seconds ahead_seconds_max background_seconds backoff_max_seconds backoff_min_seconds
    bootstrap_seconds camera_events_per_second_max candidates_max commit_events_max
    confirm_seconds future_seconds_max gap_seconds hardware_decoding held_events_max
    history_bytes_max hung_seconds inbox_camera_events_max inbox_events_max learn.cameras_max
    learn_events_max learn_seconds missed_share_max open_timeout_seconds overlap_max_seconds
    overlap_tolerance_seconds patience_seconds publish_probability_min publish_q_max
    pull_events_max pull_seconds query_seconds read_timeout_seconds restart_seconds_max
    restart_seconds_min settle_seconds shards snapshot_events speed spool_batch_events
    spool_kept_events stall_seconds start start_seconds stitch_seconds streams_max tracks_max
    transit_max_seconds window_camera_events window_events_max
"""
GONE = frozenset(_GONE_NAMES.split())
"""Tables, keys and table.keys of earlier versions that have gone without a replacement."""
_WHY_GONE = {
    "overlap_max_seconds": "how long before an exit objects appear in another view is found",
    "transit_max_seconds": "the longest transit time is found from the events",
}
"""Why some of these are no longer needed."""
Keys = tuple[str, ...]
"""Keys from the root of a document."""
_T = TypeVar("_T", bound=Struct)


class Mistake(NamedTuple):
    """A mistake, and the line (from 1) it is on."""

    line: int
    text: str


def syntax(text: str) -> tuple[dict[str, Any], str, list[Mistake]]:
    """Parse TOML; return the tables, the text that could be parsed, and the syntax errors.

    A line ``key = value`` with a mistake is left out and parsing continues, to find further
    mistakes.
    """
    problems: list[Mistake] = []
    lines = text.split("\n")
    while True:
        try:
            return tomllib.loads("\n".join(lines)), "\n".join(lines), problems
        except ValueError as error:
            if not isinstance(error, tomllib.TOMLDecodeError):  # of Python's int
                error = ValueError("a number has too many digits")
            message, _, place = str(error).partition(" (at ")
            match = re.match(r"line (\d+), column", place)
            number = int(match[1]) if match else len(text.rstrip("\n").split("\n"))
            if problems and number <= problems[-1].line:
                return {}, "", problems
            problems.append(Mistake(number, _sentence(message)))
            if not re.match(r"\s*[^\[#=]+=", lines[number - 1]):
                return {}, "", problems
            lines[number - 1] = ""


def key_lines(text: str) -> dict[Keys, int]:
    """Return the line (from 1) of every key and table of a valid TOML document.

    The line of a table is that of its first mention, that of a key in an inline table the line on
    which the statement begins.
    """
    lines: dict[Keys, int] = {}
    table: Keys = ()
    statement = ""
    for number, line in enumerate(text.removeprefix("\ufeff").split("\n"), 1):
        statement += line + "\n"
        try:
            paths = list(_paths(tomllib.loads(statement)))
        except tomllib.TOMLDecodeError:
            continue  # it goes on in the next line
        if paths and statement.lstrip().startswith("["):
            table = paths[-1]
        else:
            paths = [(*table, *path) for path in paths]
        for path in paths:
            lines.setdefault(path, number + 1 - statement.count("\n"))
        statement = ""
    return lines


def _paths(table: dict[str, Any], parent: Keys = ()) -> Iterator[Keys]:
    """Yield the path of every key in ``table``."""
    for key, value in table.items():
        yield (*parent, key)
        if isinstance(value, dict):
            yield from _paths(value, (*parent, key))


class TableReader:
    """Builds structs from the tables that tomllib read.

    tables: struct of each table, by its dotted name; for hints.
    lines: line of each key, as of `key_lines`.
    """

    def __init__(self, tables: dict[str, type[Struct]], lines: dict[Keys, int]) -> None:
        self.problems: list[Mistake] = []
        self._tables = tables
        self._lines = lines

    def table(self, defaults: _T, data: Any, path: Keys) -> _T:
        """Return ``defaults`` with the settings of the table ``data`` at ``path``.

        Mistakes are reported, and left out.
        """
        title = ".".join(path)
        if not isinstance(data, dict):
            self.report(path, f"expected a table [{title}]")
            return defaults
        fields_by_name = {field.name: field for field in fields(title, type(defaults))}
        values = {}
        for key, value in data.items():
            place = (*path, key)
            if is_gone(title, key):
                cause = _WHY_GONE.get(key)
                reason = "no longer needed" if cause is None else f"no longer needed, as {cause}"
                self.report(place, f"{reason}: delete it")
            elif key not in fields_by_name:
                self.report(place, f"no such key{self._hint(key, value, list(fields_by_name))}")
            elif isinstance(inner := getattr(defaults, key), Struct):
                values[key] = self.table(inner, value, place)
            else:
                try:
                    values[key] = _converted(fields_by_name[key].type, value)
                except ValueError as error:
                    self.report(place, str(error))
        return msgspec.structs.replace(defaults, **values)

    def report(self, path: Keys, text: str) -> None:
        """Report a mistake at ``path``, or at the nearest table around it that has a line."""
        place = path
        while place and place not in self._lines:
            place = place[:-1]
        self.problems.append(Mistake(self._lines.get(place, 1), f"{'.'.join(path)}: {text}"))

    def _hint(self, key: str, value: Any, keys: list[str]) -> str:
        """Return the tables where a key that does not exist may have its value, or a like key."""
        homes = [
            f"[{title}]"
            for title, kind in self._tables.items()
            for field in fields(title, kind)
            if field.name == key and _is_valid(field.type, value)
        ]
        return (
            f"; a key of this name is in {', '.join(homes)}" if homes else did_you_mean(key, keys)
        )


def is_gone(table: str, key: str) -> bool:
    """Return True if files of earlier versions could have ``key`` in ``table``, and now cannot."""
    return key in GONE or f"{table}.{key}" in GONE


def fields(table: str, kind: type[Struct]) -> list[msgspec.structs.FieldInfo]:
    """Return the fields of ``kind`` that a file may set in ``table``."""
    return [field for field in msgspec.structs.fields(kind) if not is_gone(table, field.name)]


def did_you_mean(key: str, keys: list[str]) -> str:
    """Return the second half of a sentence about a key that does not exist."""
    close = difflib.get_close_matches(key, keys, n=1, cutoff=0.7)
    return f"; did you mean {close[0]!r}?" if close else f"; known are {', '.join(keys)}"


def _converted(kind: Any, value: Any) -> Any:
    """Return a value of a file as ``kind``; raise `ValueError` that says what is expected."""
    try:
        if kind in (Areas, Places):
            value = _polygons(value)
        result = msgspec.convert(value, kind)
    except ValueError as error:
        words = [meta.description for meta in getattr(kind, "__metadata__", ())]
        reason = next((f"expected {text}" for text in words if text), _sentence(str(error)))
        raise ValueError(reason) from None
    if isinstance(result, float) and not abs(result) <= FLOAT_MAX:
        raise ValueError(f"expected a number of at most {FLOAT_MAX:g}")
    return result


def _is_valid(kind: Any, value: Any) -> bool:
    """Return True if a value of a file is a ``kind``."""
    with contextlib.suppress(ValueError):
        _converted(kind, value)
        return True
    return False


def _polygons(value: Any) -> Any:
    """Return polygons as lists of points, of all forms that a file may have.

    A polygon is a list of points [x, y], a text such as "0.1,0.2,0.3,0.4,0.5,0.6" (x and y in turn,
    as Frigate writes a motion mask), or a single point. One text may stand for the whole list.
    Raises `ValueError` for a text without numbers.
    """
    if isinstance(value, str):
        value = [value]
    if not isinstance(value, list):
        return value
    polygons: list[Any] = []
    for polygon in value:
        if isinstance(polygon, str):
            numbers = [float(part) for part in polygon.split(",")]
            polygons.append([numbers[at : at + 2] for at in range(0, len(numbers), 2)])
        elif isinstance(polygon, list) and polygon and not isinstance(polygon[0], list):
            polygons.append([polygon])
        else:
            polygons.append(polygon)
    return polygons


def _sentence(message: str) -> str:
    """Return a message of msgspec or tomllib as the second half of a sentence, in TOML's words."""
    message = re.sub(r" - at `\$.*", "", message)
    words = {
        "`float`": "a number",
        "`int`": "a whole number",
        "`str`": "a string",
        "`bool`": "true or false",
        "`array`": "an array",
        "`object`": "a table",
    }
    for foreign_word, word in words.items():
        message = message.replace(foreign_word, word)
    return message[:1].lower() + message[1:]
