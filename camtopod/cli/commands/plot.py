"""`camtopod plot`: a figure of a topology for a paper."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from camtopod.cli import exits
from camtopod.cli.common import open_output, topology_of


def add_parser(add: Any) -> None:
    """Add `plot`."""
    parser = add(
        description="Draws a figure of a topology with matplotlib, the extra [plot]: its map, the "
        "matrix of the next cameras, or the transit times between two cameras or zones.",
        epilog="example: camtopod plot topology.json times lobby hall --out times.pdf",
    )
    parser.add_argument("topology", metavar="TOPOLOGY.json", help="as `camtopod learn` writes it")
    parser.add_argument(
        "figure",
        metavar="FIGURE",
        choices=("map", "matrix", "times"),
        help="what to draw: map, matrix or times",
    )
    parser.add_argument(
        "places", nargs="*", default=[], metavar="FROM TO", help="of `times`: two cameras or zones"
    )
    parser.add_argument(
        "--out", metavar="FILE", required=True, help="write to FILE: .png, .pdf, .svg ..."
    )


def run(args: argparse.Namespace) -> None:
    """Write the figure. Raises `exits.CommandError`."""
    if len(args.places) != 2 * (args.figure == "times"):
        raise exits.CommandError(
            "plot: `times` needs two cameras or zones, the other figures none", exits.USAGE
        )
    try:
        from camtopod import plot

        draw: Any = {"map": plot.network, "matrix": plot.matrix, "times": plot.times}[args.figure]
        axes = draw(topology_of(args.topology), *args.places)
        with open_output(args.out) as file:
            axes.figure.savefig(file, format=Path(args.out).suffix[1:] or "png", dpi=200)
    except (ModuleNotFoundError, KeyError, ValueError) as error:
        raise exits.CommandError(f"plot: {error.args[0]}") from None
