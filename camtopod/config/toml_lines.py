"""Find the line of each key of a TOML document; the standard library's parser does not tell."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from typing import Any

Path = tuple[str, ...]
"""Keys from the root."""


def key_lines(text: str) -> dict[Path, int]:
    """Return the line (from 1) of every key and table of a valid TOML document.

    The line of a table is that of its first mention, that of a key in an inline table the line on
    which the statement begins.
    """
    lines: dict[Path, int] = {}
    table: Path = ()
    statement = ""
    for number, line in enumerate(text.split("\n"), 1):
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


def _paths(table: dict[str, Any], parent: Path = ()) -> Iterator[Path]:
    """Yield the path of every key in ``table``."""
    for key, value in table.items():
        yield (*parent, key)
        if isinstance(value, dict):
            yield from _paths(value, (*parent, key))
