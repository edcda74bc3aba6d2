"""`camtopod export`: convert a topology to a picture or an exchange format."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from pathlib import Path
from typing import Any, BinaryIO

from camtopod.cli import exits
from camtopod.cli.common import writing
from camtopod.cli.events.event_lines import open_input
from camtopod.codec import Rejected, decode_topology
from camtopod.export import FORMATS, camera_numbers
from camtopod.records import Topology

TOPOLOGY_BYTES_MAX = 512 * 1024**2
"""Largest topology file; that of a site with a thousand cameras has some tens of millions of bytes.
"""
TOO_LONG = f"it has more than {TOPOLOGY_BYTES_MAX} bytes"
"""Reason for refusing a larger file."""


def add_parser(subparsers: Any) -> None:
    """Add `export`."""
    parser = subparsers.add_parser(
        "export",
        help="convert a topology to a picture or an exchange format",
        description="Converts a topology to a picture or an exchange format.",
        epilog="example: camtopod export topology.json --format dot --out topology.dot",
    )
    parser.add_argument(
        "topology",
        metavar="TOPOLOGY.json",
        help="topology as `camtopod learn` writes it ('-': standard input)",
    )
    parser.add_argument("--format", choices=FORMATS, required=True, help="format of the output")
    parser.add_argument(
        "--out", metavar="FILE", default="-", help="write to FILE (default: standard output)"
    )


def run(args: argparse.Namespace) -> int:
    """Write the export. Raises `exits.InputError` if the topology cannot be read."""
    topology = load(args.topology)
    text = FORMATS[args.format](topology)
    if args.out == "-":
        sys.stdout.write(text)
    else:
        with writing(args.out):
            Path(args.out).write_text(text, encoding="utf-8")
    numbers = camera_numbers(topology) if args.format == "aicity" else {}
    if any(str(number) != name for name, number in numbers.items()):
        shown = ", ".join(f"{number} is {name}" for name, number in numbers.items())
        print(f"export: cameras are numbered in this format: {shown}", file=sys.stderr)
    return exits.DONE


def load(path: str) -> Topology:
    """Return a topology from a JSON file ('-': standard input). Raises `exits.InputError`."""
    file = open_input(path)
    with contextlib.nullcontext() if path == "-" else file:
        try:
            if path != "-" and os.fstat(file.fileno()).st_size > TOPOLOGY_BYTES_MAX:
                raise Rejected("too-long", TOO_LONG)
            return decode_topology(_content(file))
        except OSError as error:
            raise exits.InputError(f"cannot read {path}: {error.strerror}") from None
        except Rejected as error:
            raise exits.InputError(f"{path} is not a topology: {error}") from None


def _content(file: BinaryIO) -> bytes:
    """Return the whole content.

    Raises `Rejected` as soon as more than `TOPOLOGY_BYTES_MAX` have been read, to bound memory.
    """
    pieces: list[bytes] = []
    total = 0
    while piece := file.read(1 << 20):
        pieces.append(piece)
        total += len(piece)
        if total > TOPOLOGY_BYTES_MAX:
            raise Rejected("too-long", TOO_LONG)
    return b"".join(pieces)
