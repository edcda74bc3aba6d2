"""Texts generated from the types, defaults and docstrings of settings and messages.

`example_config` writes the example configuration (`camtopod check --example`), `schemas` the JSON
Schemas (`camtopod schema`).
"""

from camtopod.cli.generated.example_config import example as example, table as table
from camtopod.cli.generated.schemas import NAMES as NAMES, schema_text as schema_text
