"""`camtopod merge`: make one topology of those of a city's districts."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from camtopod.city.joined_map import JoinedMap
from camtopod.city.merge import merge
from camtopod.cli.common import counted, districts_of, open_output, topology_of
from camtopod.cli.exits import CommandError
from camtopod.codec import to_json


def add_parser(add: Any) -> None:
    """Add `merge`."""
    parser = add(
        description="Makes one topology of those of a city's districts, which it has whole: "
        "predictions, matches and scores are those of the camera's owner. `export` and `report` "
        "show all as one map. Nothing is learned anew.",
        epilog="example: camtopod merge d1.json d2.json --districts districts.toml --out city.json",
    )
    parser.add_argument(
        "topologies",
        nargs="+",
        metavar="TOPOLOGY.json",
        help="topologies of all districts, as `camtopod learn --site DISTRICT` writes them",
    )
    parser.add_argument(
        "--districts",
        metavar="FILE",
        type=Path,
        required=True,
        help="the districts, as `camtopod districts` writes them",
    )
    parser.add_argument(
        "--out", metavar="FILE", default="-", help="write to FILE (default: standard output)"
    )


def run(args: argparse.Namespace) -> None:
    """Write the city's topology. Raises `OSError`, `CommandError`."""
    districts = districts_of(args.districts)
    parts = [topology_of(path) for path in args.topologies]
    try:
        city = merge(parts, districts, args.site or "city")
    except ValueError as error:
        raise CommandError(f"these are not the districts of one city:\n{error}") from None
    write(city, args.out)


def write(city: JoinedMap, out: str | Path) -> None:
    """Write a city's topology, and count what its map leaves out. Raises `CommandError`."""
    topology, zones, links = city
    with open_output(out) as file:
        file.write(to_json(topology) + b"\n")
    if zones:
        print(
            f"camtopod: {counted(zones, 'zone')} of cameras beyond a border are at no place that "
            f"the owner knows; {counted(links, 'link')} to them are not in the map",
            file=sys.stderr,
        )
