"""`camtopod export`: convert a topology to a picture or an exchange format."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from camtopod.cli.common import open_output, topology_of
from camtopod.export import FORMATS, camera_numbers, export_topology


def add_parser(add: Any) -> None:
    """Add `export`."""
    parser = add(
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
        "--weak", action="store_true", help="also draw links with half of their evidence, dashed"
    )
    parser.add_argument(
        "--out", metavar="FILE", default="-", help="write to FILE (default: standard output)"
    )


def run(args: argparse.Namespace) -> None:
    """Write the export. Raises `exits.InputError` if the topology cannot be read."""
    topology = topology_of(args.topology)
    text = export_topology(topology, args.format, weak=args.weak)
    with open_output(args.out) as file:
        file.write(text.encode())
    if args.format == "aicity":
        numbers = camera_numbers(topology).items()
        numbering = ", ".join(f"{number} is {name}" for name, number in numbers)
        print(f"export: cameras are numbered in this format: {numbering}", file=sys.stderr)
