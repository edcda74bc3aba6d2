"""Texts generated from the settings' types, defaults and docstrings.

`example_config` writes the example configuration (`camtopod check --example`), `config_schema` its
JSON Schema for editors (`camtopod check --schema`), `message_schemas` the schemas of the messages
on the bus (`camtopod schema`).
"""

from __future__ import annotations

from camtopod.cli.generated.config_schema import text as text
from camtopod.cli.generated.example_config import example as example, table as table
from camtopod.cli.generated.message_schemas import NAMES as NAMES, schema_text as schema_text
