"""The command line; one module a command."""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import names_from

if TYPE_CHECKING:
    from camtopod.cli.main import console

__all__ = [
    "console",
]

__getattr__ = names_from(
    __name__,
    {
        "console": "main",
    },
)
