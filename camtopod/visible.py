"""Make untrusted text harmless to a terminal and a log.

All printed and logged text goes through `visible`.
"""

from __future__ import annotations

import json

_INDENT = "    "


def visible(text: str) -> str:
    r"""Return ``text`` on one line, with unprintable characters as JSON escapes such as ``\u001b``.

    Unprintable are control characters (C0, C1), line separators, characters that change the
    direction of writing, and lone surrogates. JSON stays JSON of the same content.
    """
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else json.dumps(char)[1:-1] for char in text)


def visible_lines(text: str) -> str:
    """Return several lines made `visible`, indented after the first.

    So none of them looks like another message.
    """
    return f"\n{_INDENT}".join(visible(line) for line in text.split("\n"))
