"""Find the line of each key of a TOML document; the standard library's parser does not tell."""

from __future__ import annotations

import re
import tomllib

Path = tuple[str | int, ...]
"""Keys from the root; the key of an array's element (or of a table in an array) is its index."""

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_BLANK = re.compile(r"(?:[ \t\r\n]+|#[^\n]*)*")
_STRINGS = (
    re.compile(r'"""(?:\\.|[^\\])*?"{3,5}(?!")', re.DOTALL),
    re.compile(r"'''.*?'{3,5}(?!')", re.DOTALL),
    re.compile(r'"(?:\\.|[^"\\\n])*"'),
    re.compile(r"'[^'\n]*'"),
)
_SCALAR = re.compile(r"[^,\]}\n#]*")


def key_lines(text: str) -> dict[Path, int]:
    """Return the line (from 1) of every key, table and array element of a valid TOML document.

    The line of a table is that of its first mention. For an invalid document the result is
    unspecified, but the function ends.
    """
    return _Scanner(text).document()


class _Scanner:
    """A scanner that steps through a TOML document and notes lines, without reading values."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._at = 0
        self._lines: dict[Path, int] = {}
        self._arrays: dict[Path, int] = {}  # arrays of tables -> index of the last element so far

    def document(self) -> dict[Path, int]:
        table: Path = ()
        while self._skip_blank():
            start = self._at
            if self._take("[["):
                table = self._array_table(self._key())
                self._take("]]")
            elif self._take("["):
                table = self._resolve(self._key())
                self._take("]")
                self._mark(table)
            else:
                self._pair(table)
            if self._at == start:  # not TOML: step over it
                self._at += 1
        return self._lines

    def _pair(self, table: Path) -> None:
        """Step over ``key = value``."""
        key = table
        for part in self._key():
            key = (*key, part)
            self._mark(key)
        self._skip_blank()
        if self._take("="):
            self._value(key)

    def _value(self, path: Path) -> None:
        self._skip_blank()

        # An array.
        if self._take("["):
            index = 0
            while self._skip_blank() and not self._take("]"):
                self._mark((*path, index))
                self._value((*path, index))
                self._skip_blank()
                self._take(",")
                index += 1

        # An inline table.
        elif self._take("{"):
            while self._skip_blank() and not self._take("}"):
                start = self._at
                self._pair(path)
                self._skip_blank()
                self._take(",")
                if self._at == start:
                    return

        # A number, a date or a boolean.
        elif not self._string():
            match = _SCALAR.match(self._text, self._at)
            assert match is not None  # it matches the empty text too
            self._at = max(match.end(), min(self._at + 1, len(self._text)))

    def _key(self) -> list[str]:
        parts: list[str] = []
        while True:
            self._skip_blank()
            start = self._at
            if match := _BARE.match(self._text, self._at):
                self._at = match.end()
                parts.append(match.group())
            elif self._string():
                parts.append(_unquote(self._text[start : self._at]))
            else:
                return parts
            self._skip_blank()
            if not self._take("."):
                return parts

    def _resolve(self, key: list[str]) -> Path:
        """Return the path of a table header; in an array of tables, that of its last element."""
        path: Path = ()
        for part in key:
            path = (*path, part)
            if path in self._arrays:
                path = (*path, self._arrays[path])
        return path

    def _array_table(self, key: list[str]) -> Path:
        path: Path = (*self._resolve(key[:-1]), *key[-1:])
        self._arrays[path] = self._arrays.get(path, -1) + 1
        self._mark(path)
        element = (*path, self._arrays[path])
        self._mark(element)
        return element

    def _mark(self, path: Path) -> None:
        """Note the present line for ``path``, and for the tables around it without one."""
        line = self._text.count("\n", 0, self._at) + 1
        for end in range(1, len(path) + 1):
            self._lines.setdefault(path[:end], line)

    def _string(self) -> bool:
        """Step over a string if one comes next; return whether it did."""
        for pattern in _STRINGS:
            if match := pattern.match(self._text, self._at):
                self._at = match.end()
                return True
        return False

    def _skip_blank(self) -> bool:
        """Step over white space and comments; return False at the end."""
        match = _BLANK.match(self._text, self._at)
        assert match is not None  # it matches the empty text too
        self._at = match.end()
        return self._at < len(self._text)

    def _take(self, token: str) -> bool:
        """Step over ``token`` if it comes next; return whether it did."""
        if self._text.startswith(token, self._at):
            self._at += len(token)
            return True
        return False


def _unquote(token: str) -> str:
    try:
        return str(tomllib.loads(f"k = {token}")["k"])
    except tomllib.TOMLDecodeError:
        return token.strip("\"'")
