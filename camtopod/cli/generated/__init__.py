"""Texts generated from the settings' types, defaults and docstrings.

`example_config` writes the example configuration (`camtopod check --example`), `config_schema` its
JSON Schema for editors (`camtopod check --schema`), `message_schemas` the schemas of the messages
on the bus (`camtopod schema`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.cli.generated.config_schema import text
    from camtopod.cli.generated.example_config import example, table
    from camtopod.cli.generated.message_schemas import NAMES, schema_text

__all__ = [
    "NAMES",
    "example",
    "schema_text",
    "table",
    "text",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "NAMES": "message_schemas",
        "example": "example_config",
        "schema_text": "message_schemas",
        "table": "example_config",
        "text": "config_schema",
    },
)
