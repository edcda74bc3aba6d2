"""TOML -> structs, collecting every mistake with its line instead of stopping at the first."""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from typing import Annotated, Any, NamedTuple, TypeVar

import msgspec
from msgspec import Meta, Struct

from camtopod.config import toml_lines

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
ENDPOINT_PATTERN = r"^(tcp|udp|tls|quic|ws|unixsock-stream|vsock|serial)/\S+\Z"
Endpoint = Annotated[str, Meta(pattern=ENDPOINT_PATTERN)]
FLOAT_MAX = 9e9
"""No system waits for longer, in seconds; and a time before the year 2255."""
_SYNTAX_ERRORS_MAX = 20
_T = TypeVar("_T", bound=Struct)


class Problem(NamedTuple):
    """One mistake and the line (from 1) it is on."""

    line: int
    what: str


def syntax(text: str) -> tuple[dict[str, Any], str, list[Problem]]:
    """Parse; after a mistake in a ``key = value`` line go on without that line, to find the others
    too.
    """
    problems: list[Problem] = []
    while len(problems) < _SYNTAX_ERRORS_MAX:
        try:
            return tomllib.loads(text), text, problems
        except tomllib.TOMLDecodeError as error:
            match = re.search(r"(.*) \(at (?:line (\d+)|end of document)", str(error))
            lines = text.split("\n")
            number = int(match[2]) if match and match[2] else len(text.rstrip("\n").split("\n"))
            problem = Problem(number, _sentence(match[1] if match else str(error)))
            if problems and number <= problems[-1].line:
                break
            problems.append(problem)
            if match is None or not match[2] or not re.match(r"\s*[^\[#=]+=", lines[number - 1]):
                break
            lines[number - 1] = ""
            text = "\n".join(lines)
    return {}, "", problems


class TableReader:
    """Builds structs from the tables that tomllib read. ``tables``: dotted name -> struct."""

    def __init__(
        self,
        tables: dict[str, type[Struct]],
        lines: dict[toml_lines.Path, int],
        missing_matters: bool,
    ) -> None:
        self.problems: list[Problem] = []
        self._tables = tables
        self._lines = lines
        self._missing_matters = missing_matters

    def table(self, kind: type[_T], parent: dict[str, Any], path: tuple[str, ...]) -> _T | None:
        """The struct at ``path``, with the default for each mistake; None if a required key is
        missing.
        """
        title = ".".join(path)
        data = parent.get(path[-1], {})
        if not isinstance(data, dict):
            self.say(path, f"{title}: expected a table [{title}]")
            return None if any(field.required for field in msgspec.structs.fields(kind)) else kind()
        fields = {field.name: field for field in msgspec.structs.fields(kind)}
        values: dict[str, Any] = {}
        for key, value in data.items():
            if key not in fields:
                self.say(
                    (*path, key),
                    f"{title}.{key}: no such key{self._hint(key, list(fields), path[0])}",
                )
            elif (nested := self._tables.get(f"{title}.{key}")) is not None:
                values[key] = self.table(nested, data, (*path, key))
            elif (converted := self._value(fields[key], value, (*path, key))) is not None:
                values[key] = converted
        for field in fields.values():
            if field.required and field.name not in data and self._missing_matters:
                self.say(path, f"{title}: {field.name} is missing")
            if field.required and field.name not in values:
                return None
        return kind(**values)

    def _value(self, field: msgspec.structs.FieldInfo, value: Any, path: toml_lines.Path) -> Any:
        """``value`` as the field's type, or None after saying why not; each element of an array by
        itself.
        """
        title = ".".join(str(part) for part in path[:3])
        if field.type == tuple[Endpoint, ...] and isinstance(value, list):
            for index, endpoint in enumerate(value):
                if not is_endpoint(endpoint):
                    what = f"{title}: {endpoint!r} is not an endpoint; write it like {DEFAULT_ENDPOINT!r}"
                    self.say((*path, index), what)
            return tuple(value)
        try:
            converted = msgspec.convert(value, field.type)
            _check_number(converted, field.default)
        except ValueError as error:
            self.say(
                path,
                f"{title}: {_in_words(field) if 'matching regex' in str(error) else _sentence(str(error))}",
            )
            return None
        return converted

    def say(self, path: toml_lines.Path, what: str) -> None:
        """A mistake at ``path``, or where its nearest table begins."""
        while path and path not in self._lines:
            path = path[:-1]
        self.problems.append(Problem(self._lines.get(path, 1), what))

    def _hint(self, key: str, known: list[str], table: str) -> str:
        homes = [
            name
            for name, kind in self._tables.items()
            if name != table and key in kind.__struct_fields__
        ]
        return f"; it belongs in [{homes[0]}]" if homes else did_you_mean(key, known)


def is_endpoint(value: object) -> bool:
    """Whether ``value`` looks like an endpoint of zenoh: protocol/address."""
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
    """What the field's pattern asks for, which is told better than shown."""
    metas = getattr(field.type, "__metadata__", ())
    return f"expected {next(meta.description for meta in metas if meta.description)}"


def did_you_mean(key: str, known: list[str]) -> str:
    """The second half of a sentence about a key that does not exist."""
    close = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
    return f"; did you mean {close[0]!r}?" if close else f"; known are {', '.join(known)}"


def _sentence(message: str) -> str:
    """A message of msgspec or tomllib as the second half of a sentence, in TOML's words."""
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
