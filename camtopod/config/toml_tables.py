"""Make structs of TOML, collecting all mistakes with their lines, not only the first."""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple, TypeVar

import msgspec
from msgspec import Meta, Struct

from camtopod.config import polygons, toml_lines

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
"""Endpoint of a daemon that the configuration gives none."""
ENDPOINT_PATTERN = r"^(tcp|udp|tls|quic|ws|unixsock-stream|vsock|serial)/\S+\Z"
"""Regular expression of an endpoint of zenoh: protocol/address."""
Endpoint = Annotated[str, Meta(pattern=ENDPOINT_PATTERN)]
FLOAT_MAX = 9e9
"""Largest number that a setting may have.

No operating system waits for longer, in seconds, and as a time it is in 2255.
"""
_SYNTAX_ERRORS_MAX = 20
"""Syntax errors after which `syntax` stops."""
_ELSEWHERE = {
    "mask": "ignore",
    "motion": "ignore",
    "threshold": "sensitivity",
    "min_area": "min_height",
    "area": "min_height",
}
"""Names of similar settings in Frigate and Viseron -> their names here."""
_GONE = frozenset(
    {
        "ack_seconds",
        "ahead_seconds_max",
        "background_seconds",
        "backoff_max_seconds",
        "backoff_min_seconds",
        "bootstrap_seconds",
        "camera_events_per_second_max",
        "candidates_max",
        "commit_events_max",
        "confirm_seconds",
        "future_seconds_max",
        "gap_seconds",
        "hardware_decoding",
        "held_events_max",
        "history_bytes_max",
        "hung_seconds",
        "inbox_camera_events_max",
        "inbox_events_max",
        "learn.cameras_max",
        "learn_events_max",
        "learn_seconds",
        "missed_share_max",
        "open_timeout_seconds",
        "overlap_max_seconds",
        "overlap_tolerance_seconds",
        "patience_seconds",
        "publish_probability_min",
        "publish_q_max",
        "pull_events_max",
        "pull_seconds",
        "query_seconds",
        "read_timeout_seconds",
        "restart_seconds_max",
        "restart_seconds_min",
        "settle_seconds",
        "shards",
        "snapshot_events",
        "speed",
        "spool_batch_events",
        "spool_kept_events",
        "stall_seconds",
        "start",
        "start_seconds",
        "stitch_seconds",
        "streams_max",
        "tracks_max",
        "window_camera_events",
        "window_events_max",
    }
)
"""Tables, keys and table.keys of earlier versions that have gone without a replacement."""
_T = TypeVar("_T", bound=Struct)


class Problem(NamedTuple):
    """A mistake, and the line (from 1) it is on."""

    line: int
    what: str


def syntax(text: str) -> tuple[dict[str, Any], str, list[Problem]]:
    """Parse TOML; return the tables, the text that could be parsed, and the syntax errors.

    A line ``key = value`` with a mistake is left out and parsing continues, to find further
    mistakes.
    """
    problems: list[Problem] = []
    while len(problems) < _SYNTAX_ERRORS_MAX:
        try:
            return tomllib.loads(text), text, problems
        except tomllib.TOMLDecodeError as error:
            # Note the mistake and its line; stop if parsing does not get past it.
            match = re.search(r"(.*) \(at (?:line (\d+), column (\d+)|end of document)", str(error))
            lines = text.split("\n")
            number = int(match[2]) if match and match[2] else len(text.rstrip("\n").split("\n"))
            column = f" at column {match[3]}" if match and match[3] else ""
            problem = Problem(number, _sentence(match[1] if match else str(error)) + column)
            if problems and number <= problems[-1].line:
                break
            problems.append(problem)
            if match is None or not match[2] or not re.match(r"\s*[^\[#=]+=", lines[number - 1]):
                break

            # Try again without the line.
            lines[number - 1] = ""
            text = "\n".join(lines)
    return {}, "", problems


class TableReader:
    """Builds structs from the tables that tomllib read.

    tables: struct of each table, by its dotted name.
    lines: line of each key, as of `toml_lines.key_lines`.
    """

    def __init__(
        self,
        tables: dict[str, type[Struct]],
        lines: dict[toml_lines.Path, int],
    ) -> None:
        self.problems: list[Problem] = []
        self._tables = tables
        self._lines = lines

    def table(
        self,
        kind: type[_T],
        parent: dict[str, Any],
        path: tuple[str, ...],
        flat: Mapping[str, Struct] = MappingProxyType({}),
    ) -> _T:
        """Return the struct at ``path``, mistakes replaced by defaults.

        flat: fields of ``kind`` whose keys stand in the table itself, with the structs that have
            their defaults.
        """
        title = ".".join(path)
        data = parent.get(path[-1], {})
        if not isinstance(data, dict):
            self.report(path, f"{title}: expected a table [{title}]")
            data = {}

        # Known keys: those of the struct itself, and those of the structs in `flat`.
        own = {f.name: f for f in fields(title, kind) if f.name not in flat}
        homes = {f.name: (name, f) for name in flat for f in msgspec.structs.fields(flat[name])}
        values: dict[str, Any] = {}
        changes: dict[str, dict[str, Any]] = {name: {} for name in flat}

        # Convert each key.
        for key, value in data.items():
            if (nested := self._tables.get(f"{title}.{key}")) is not None and key in own:
                values[key] = self.table(nested, data, (*path, key))
                continue
            if is_gone(title, key):
                self.report((*path, key), f"{title}.{key}: no longer needed: delete the line")
                continue
            home, field = homes[key] if key in homes else ("", own.get(key))
            if field is None:
                hint = self._hint(key, [*own, *homes], path[0])
                self.report((*path, key), f"{title}.{key}: no such key{hint}")
            elif (converted := self._value(field, value, (*path, key))) is not None:
                (changes[home] if home else values)[key] = converted
        inner = {name: msgspec.structs.replace(flat[name], **changes[name]) for name in flat}
        return kind(**values, **inner)

    def _value(self, field: msgspec.structs.FieldInfo, value: Any, path: toml_lines.Path) -> Any:
        """Return ``value`` as the field's type, or report why it does not fit and return None.

        Each endpoint or polygon of an array is checked by itself.
        """
        title = ".".join(str(part) for part in path[:3])

        # Endpoints: report each bad one, and keep the array.
        if field.type == tuple[Endpoint, ...] and isinstance(value, list):
            for index, endpoint in enumerate(value):
                if not is_endpoint(endpoint):
                    what = (
                        f"{title}: {endpoint!r} is not an endpoint;"
                        f" write it like {DEFAULT_ENDPOINT!r}"
                    )
                    self.report((*path, index), what)
            return tuple(value)

        # Polygons: report each bad one, and keep the others.
        if points_min := polygons.points_min(field):
            found, wrong = polygons.parse(value, points_min)
            for at, what in wrong.items():
                self.report(path if at is None else (*path, at), f"{title}: {what}")
            return found

        # All other types.
        try:
            converted = msgspec.convert(value, field.type)
            _check_number(converted, field.default)
        except ValueError as error:
            self.report(
                path,
                f"{title}: "
                f"{_in_words(field) if 'matching regex' in str(error) else _sentence(str(error))}",
            )
            return None
        return converted

    def report(self, path: toml_lines.Path, what: str) -> None:
        """Report a mistake at ``path``, or at the nearest table around it that has a line."""
        while path and path not in self._lines:
            path = path[:-1]
        self.problems.append(Problem(self._lines.get(path, 1), what))

    def _hint(self, key: str, known: list[str], table: str) -> str:
        if _ELSEWHERE.get(key) in known:
            return f"; it is called {_ELSEWHERE[key]!r} here"
        homes = [
            name
            for name, kind in self._tables.items()
            if name != table and key in kind.__struct_fields__
        ]
        return f"; it belongs in [{homes[0]}]" if homes else did_you_mean(key, known)


def is_gone(table: str, key: str) -> bool:
    """Return True if files of earlier versions could have ``key`` in ``table``, and now cannot."""
    return key in _GONE or f"{table}.{key}" in _GONE


def fields(table: str, kind: type[Struct]) -> list[msgspec.structs.FieldInfo]:
    """Return the fields of ``kind`` that a file may set in ``table``."""
    return [one for one in msgspec.structs.fields(kind) if not is_gone(table, one.name)]


def is_endpoint(value: object) -> bool:
    """Return True if ``value`` looks like an endpoint of zenoh: protocol/address."""
    return isinstance(value, str) and re.match(ENDPOINT_PATTERN, value) is not None


def _check_number(value: Any, default: Any) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return
    if not math.isfinite(value):
        raise ValueError("expected a finite number")
    if isinstance(default, int | float) and default >= 0 and value < 0:
        raise ValueError("must not be negative")
    if isinstance(value, float) and value > FLOAT_MAX:
        raise ValueError(f"expected at most {FLOAT_MAX:g}")


def _in_words(field: msgspec.structs.FieldInfo) -> str:
    """Return the field's pattern in words, which are easier to read than the pattern."""
    metas = getattr(field.type, "__metadata__", ())
    return f"expected {next(meta.description for meta in metas if meta.description)}"


def did_you_mean(key: str, known: list[str]) -> str:
    """Return the second half of a sentence about a key that does not exist."""
    close = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
    return f"; did you mean {close[0]!r}?" if close else f"; known are {', '.join(known)}"


def _sentence(message: str) -> str:
    """Return a message of msgspec or tomllib as the second half of a sentence, in TOML's words."""
    message = re.sub(r" - at `\$.*", "", message)
    words = {
        "`float`": "a number",
        "`int`": "a whole number",
        "`str`": "a string",
        "`bool`": "true or false",
    }
    words |= {"`array`": "an array", "`object`": "a table"}
    for theirs, ours in words.items():
        message = message.replace(theirs, ours)
    return message[:1].lower() + message[1:]
