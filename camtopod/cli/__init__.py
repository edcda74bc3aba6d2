"""The command line of camtopod: one module a command.

Read `main` first (command table, parser, exit statuses), then `common` (configuration, logging and
signals, shared by the commands), then any module of `commands`. Below them, `cameras` supervises
one process per camera, `events` reads event lines and other programs' formats, `terminal` draws
progress and the live view, and `generated` makes the example configuration and its JSON Schema.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.cli.main import console

__all__ = [
    "console",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "console": "main",
    },
)
