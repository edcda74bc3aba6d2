"""`camtopod schema`: print the JSON Schema of a message on the bus, or of the configuration."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from camtopod.cli import exits
from camtopod.cli.generated import NAMES, schema_text


def add_parser(subparsers: Any) -> None:
    """Add `schema`."""
    parser = subparsers.add_parser(
        "schema",
        help="print the JSON Schema of a message or of the configuration",
        description="Prints the JSON Schema of one message on the bus, or of the configuration, "
        "for programs in other languages and for validators. Messages may have further fields, "
        "which a reader ignores.",
        epilog="example: camtopod schema event > event.schema.json",
    )
    parser.add_argument("name", choices=NAMES, help="the message, or configuration")


def run(args: argparse.Namespace) -> int:
    """Print the schema."""
    sys.stdout.write(schema_text(args.name))
    return exits.DONE
