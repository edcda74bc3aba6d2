"""`camtopod districts`: cut a city into districts, which are sites; write the files to run them.

The cut follows from the passages between cameras: those of a topology, which may be learned from
recorded events. With a table the cut is that of the table. The cameras beyond a border follow from
the passages in both cases.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

from msgspec import Struct

from camtopod.cli.city import deployment
from camtopod.cli.common import configuration, counted, districts_of, open_output, topology_of
from camtopod.cli.events.event_lines import LineReader, open_input, table_rows_of
from camtopod.cli.events.learning import feed
from camtopod.cli.events.recording import Times, fault_of
from camtopod.cli.exits import FAILED, USAGE, CommandError, InputError
from camtopod.config import Districts, districts_file, with_borders
from camtopod.learn.learner import Learner
from camtopod.records import CameraId, Topology
from camtopod.topology import camera_of, likely_links, links_between_views

CAMERAS_MAX = 100
"""Most cameras of a district, by default (deploy/large.md has the measurements)."""
CAMERAS_MAX_MIN = 10
"""Least value of --cameras-max: smaller districts would mostly hear the cameras of others."""
TOPOLOGY_START = b'{"schema":"camtopod/topology'
"""First bytes of a topology, without white space."""
START_BYTES = 4096
"""Bytes at the beginning of a file that tell what it is."""


class _Row(Struct):
    """A row of the table of districts."""

    camera: CameraId
    district: str


def add_parser(add: Any) -> None:
    """Add `districts`."""
    parser = add(
        description="Cuts a city into districts, each of which is a site with a learner of its "
        "own: connected groups of cameras between which few objects pass. A district hears its "
        "own cameras and their neighbours in other districts. With --deploy it writes files to run "
        "them.",
        epilog="example: camtopod districts events.jsonl --cameras-max 100 --out districts.toml",
    )
    parser.add_argument(
        "source",
        metavar="TOPOLOGY.json|EVENTS",
        help="topology as `camtopod learn` or `merge` writes it, or recorded event lines ('-': "
        "standard input); with --deploy also a file of districts, which is not cut again",
    )
    parser.add_argument(
        "--cameras-max",
        metavar="N",
        type=_cameras_max,
        default=CAMERAS_MAX,
        help=f"most cameras of a district, {CAMERAS_MAX_MIN} at least (default: {CAMERAS_MAX})",
    )
    parser.add_argument(
        "--table",
        metavar="FILE.csv",
        help="cut by this table with the columns camera and district",
    )
    parser.add_argument(
        "--out", metavar="FILE", default="-", help="write to FILE (default: standard output)"
    )
    parser.add_argument(
        "--deploy",
        nargs=2,
        metavar=("kubernetes|systemd", "DIR"),
        help="write into a new folder the manifests of all districts for Kubernetes, or units and "
        "configurations for this machine, and the configurations of the grabbers",
    )


def _cameras_max(text: str) -> int:
    """Parse the value of --cameras-max."""
    if not text.isdecimal() or not text.isascii() or int(text) < CAMERAS_MAX_MIN:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from {CAMERAS_MAX_MIN} on")
    return int(text)


def run(args: argparse.Namespace) -> int:
    """Write the districts, or the files that run them. Raises `OSError`, `CommandError`."""
    reader, times = LineReader(), Times()
    if args.deploy and args.deploy[0] not in deployment.KINDS:
        raise CommandError(f"--deploy takes {' or '.join(deployment.KINDS)}, and a folder", USAGE)
    with open_input(args.source) as file:
        start = file.peek(START_BYTES)[:START_BYTES]
        if not districts_file.is_districts(start):
            districts = _cut(args, start, reader, times)
        elif args.deploy and not args.table:
            districts = districts_of(Path(args.source), file.read())
        else:
            raise CommandError(f"{args.source} is cut already: give --deploy, no --table", USAGE)
    if args.deploy:
        deployment.write(districts, *args.deploy)
    if (fault := fault_of(times)) is not None:
        print(f"camtopod: {fault}", file=sys.stderr)
    return FAILED if fault else reader.status


def _cut(args: argparse.Namespace, start: bytes, reader: LineReader, times: Times) -> Districts:
    """Cut, write the districts, and return them. Raises `OSError`, `CommandError`.

    start: the first bytes of the source.
    reader, times: have its lines, and their times, in the end.
    """
    if b"".join(start.split()).startswith(TOPOLOGY_START):
        topology: Topology | None = topology_of(args.source)
    else:
        learner = Learner(configuration(args).learner, only_last=True)
        feed(learner, reader, [args.source], times)
        if (summary := reader.summary()) is not None:
            print(f"camtopod: {summary}", file=sys.stderr)
        topology = learner.topology
    if topology is None or not topology.cameras:
        raise InputError(f"there are no cameras in {args.source}: nothing to cut")
    cameras, passages = [camera.id for camera in topology.cameras], passages_between(topology)
    if args.table is not None:
        owners = owners_in(args.table)
    else:
        from camtopod.city.partition import partition

        try:
            owners = partition(cameras, passages, args.cameras_max)
        except ValueError as error:
            raise CommandError(f"{error}; --cameras-max takes more") from None
    if strangers := sorted({*cameras} - owners.keys()):
        raise InputError(f"{args.table} has no district for {', '.join(strangers[:20])}")
    districts = with_borders(owners, passages)
    if mistakes := [text for _, text in districts_file.mistakes(districts)]:
        raise InputError(f"{args.table}: {'; '.join(mistakes)}")

    with open_output(args.out) as file:
        file.write(districts_file.to_toml(districts).encode())
    crossing = sum(number for (a, b), number in passages.items() if owners[a] != owners[b])
    share = crossing / max(sum(passages.values()), 1e-9)
    largest = max(len(district.cameras) for district in districts.values())
    heard_count = sum(len(district.hears) for district in districts.values())
    print(
        f"camtopod: {counted(len(districts), 'district')} of up to {counted(largest, 'camera')}, "
        f"which hear {heard_count} of others; {share:.1%} of what "
        "passes goes from one to another",
        file=sys.stderr,
    )
    return districts


def passages_between(topology: Topology) -> dict[tuple[str, str], float]:
    """Return the expected transitions between cameras, both ways together, by sorted pair.

    Links with half of their evidence count, too.
    """
    result: dict[tuple[str, str], float] = defaultdict(float)
    for link in (*links_between_views(topology), *likely_links(topology)):
        a, b = sorted((camera_of(link.from_), camera_of(link.to)))
        if a != b:
            result[a, b] += link.transitions
    return dict(result)


def owners_in(path: str) -> dict[str, str]:
    """Return the district of each camera in a table. Raises `InputError`."""
    owners: dict[str, str] = {}
    for number, row in table_rows_of(path, ("camera", "district"), _Row):
        if owners.setdefault(row.camera, row.district) != row.district:
            raise InputError(f"{path}:{number}: {row.camera} has two districts")
    return owners
