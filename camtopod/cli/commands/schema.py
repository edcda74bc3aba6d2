"""`camtopod schema`: print the JSON Schema of a message on the bus, or of the configuration."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from camtopod.cli.generated import NAMES, schema_text


def add_parser(add: Any) -> None:
    """Add `schema`."""
    parser = add(
        description="Prints the JSON Schema of one message on the bus, or of the configuration, "
        "for programs in other languages and for validators. Messages may have further fields, "
        "which a reader ignores.",
        epilog="example: camtopod schema event > event.schema.json",
    )
    parser.add_argument("name", choices=NAMES, help="the message, or configuration")


def run(args: argparse.Namespace) -> None:
    """Print the schema."""
    sys.stdout.write(schema_text(args.name))
