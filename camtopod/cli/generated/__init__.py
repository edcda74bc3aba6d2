"""Texts generated from the settings' types, defaults and docstrings.

`example_config` writes the example configuration (`camtopod check --example`), `config_schema` its
JSON Schema for editors (`camtopod check --schema`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.cli.generated.config_schema import text
    from camtopod.cli.generated.example_config import example, table

__all__ = [
    "example",
    "table",
    "text",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "example": "example_config",
        "table": "example_config",
        "text": "config_schema",
    },
)
