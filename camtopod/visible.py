"""The one place where text of others is made harmless to a terminal and to a log: what is printed
or logged goes through `visible`.
"""

from __future__ import annotations

import json

_INDENT = "    "


def visible(text: str) -> str:
    """``text`` on one line, with every character that is not printable as JSON writes it, for
    example ``\\u001b``.

    Not printable are control characters (C0, C1), line separators, characters that change the
    direction of writing, and lone surrogates. JSON stays JSON of the same content.
    """
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else json.dumps(char)[1:-1] for char in text)


def visible_lines(text: str) -> str:
    """The same for several lines; those after the first are indented, so that none passes for
    another message.
    """
    return f"\n{_INDENT}".join(visible(line) for line in text.split("\n"))
