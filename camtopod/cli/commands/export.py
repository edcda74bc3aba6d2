"""`camtopod export`: a topology as a picture or in an exchange format."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from pathlib import Path
from typing import Any, BinaryIO

from camtopod.cli import exits
from camtopod.cli.events import open_input
from camtopod.codec import Rejected, read_topology
from camtopod.export import FORMATS, camera_numbers
from camtopod.records import Topology

TOPOLOGY_BYTES_MAX = 512 * 1024**2
"""Of a file; that of a site with a thousand cameras has some tens of millions."""
TOO_LONG = f"it has more than {TOPOLOGY_BYTES_MAX} bytes"
_PIECE_BYTES = 1 << 20


def add_parser(subparsers: Any) -> None:
    """Add `export`."""
    summary = "a topology as a picture or in an exchange format"
    parser = subparsers.add_parser("export", help=summary, description=summary.capitalize() + ".")
    parser.add_argument(
        "topology", metavar="TOPOLOGY.json", help="what `learn` wrote ('-': standard input)"
    )
    parser.add_argument("--format", choices=FORMATS, required=True)
    parser.add_argument("--out", metavar="FILE", default="-", help="default: standard output")


def run(args: argparse.Namespace) -> int:
    """Write the export; raises `exits.InputError` when the topology cannot be read."""
    topology = load(args.topology)
    text = FORMATS[args.format](topology)
    if args.out == "-":
        sys.stdout.write(text)
    else:
        try:
            Path(args.out).write_text(text, encoding="utf-8")
        except OSError as error:
            raise exits.CommandError(f"export: cannot write {args.out}: {error.strerror}") from None
    numbers = camera_numbers(topology) if args.format == "aicity" else {}
    if any(str(number) != name for name, number in numbers.items()):
        shown = ", ".join(f"{number} is {name}" for name, number in numbers.items())
        print(f"export: the format numbers cameras: {shown}", file=sys.stderr)
    return exits.DONE


def load(path: str) -> Topology:
    """A topology from a JSON file ('-': standard input); raises `exits.InputError`."""
    file = open_input(path)
    with contextlib.nullcontext() if path == "-" else file:
        try:
            if path != "-" and os.fstat(file.fileno()).st_size > TOPOLOGY_BYTES_MAX:
                raise Rejected("too-long", TOO_LONG)
            return read_topology(_content(file))
        except OSError as error:
            raise exits.InputError(f"cannot read {path}: {error.strerror}") from None
        except Rejected as error:
            raise exits.InputError(f"{path} is not a topology: {error}") from None


def _content(file: BinaryIO) -> bytes:
    """All of it. Raises `Rejected` where that is more than `TOPOLOGY_BYTES_MAX`, before it is in
    memory.
    """
    pieces: list[bytes] = []
    total = 0
    while piece := file.read(_PIECE_BYTES):
        pieces.append(piece)
        total += len(piece)
        if total > TOPOLOGY_BYTES_MAX:
            raise Rejected("too-long", TOO_LONG)
    return b"".join(pieces)
