"""`camtopod report`: write the web page of one topology to a file that needs no server."""

from __future__ import annotations

import argparse
from collections import deque
from pathlib import Path
from typing import Any

from camtopod.cli.common import configuration, open_output, topology_of
from camtopod.cli.exits import InputError
from camtopod.codec import Rejected, decode_topology
from camtopod.records import Topology
from camtopod.web import report, single_file

OLDER_MAX = 200
"""Most earlier versions on the time line; each takes as much memory as the topology."""


def add_parser(add: Any) -> None:
    """Add `report`."""
    parser = add(
        description="Writes what `camtopod web` shows of a topology to one HTML file: map, "
        "cameras, links, versions. It needs no server and loads nothing from other sites.",
        epilog="example: camtopod report topology.json --out report.html",
    )
    parser.add_argument(
        "topology",
        metavar="TOPOLOGY.json",
        help="topology as `camtopod learn` writes it ('-': standard input)",
    )
    parser.add_argument(
        "--out", metavar="FILE", default="-", help="write to FILE (default: standard output)"
    )
    parser.add_argument(
        "--updates",
        metavar="FILE",
        type=Path,
        help="earlier versions, as `camtopod learn --updates` writes them",
    )
    parser.add_argument(
        "--pictures",
        metavar="DIR",
        type=Path,
        help="directory with a picture of each camera, CAMERA.jpg or CAMERA.png, to include in the "
        "file (default: [web] pictures)",
    )


def run(args: argparse.Namespace) -> None:
    """Write the report. Raises `CommandError`."""
    topology = topology_of(args.topology)
    if args.pictures is not None and not args.pictures.is_dir():
        raise InputError(f"--pictures {args.pictures}: no such directory")
    older = _older(args.updates, topology) if args.updates else []
    pictures = args.pictures or configuration(args).web.pictures_folder
    text = single_file.page(report.gather(topology, older, pictures))
    with open_output(args.out) as file:
        file.write(text.encode())


def _older(path: Path, topology: Topology) -> list[Topology]:
    """Return the earlier versions of the topology's epoch, the newest `OLDER_MAX`."""
    topologies: deque[Topology] = deque(maxlen=OLDER_MAX)
    with path.open("rb") as file:  # `main` reports an OSError
        for number, line in enumerate(file, 1):
            try:
                candidate = decode_topology(line)
            except Rejected as error:
                raise InputError(f"{path}, line {number} is not a topology: {error}") from None
            if candidate.epoch == topology.epoch and candidate.version < topology.version:
                topologies.append(candidate)
    return [*topologies]
