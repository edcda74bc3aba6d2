"""`camtopod score`: score links, predictions and matches by known identities."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from typing import Any

from msgspec import Struct

from camtopod.cli import exits
from camtopod.cli.common import topology_of
from camtopod.cli.events.event_lines import LineReader, table_rows_of
from camtopod.cli.events.recording import Times, fault_of, foreign_cameras, once_by_number, recorded
from camtopod.cli.exits import InputError
from camtopod.cli.terminal import ProgressLine
from camtopod.scoring import score

IDENTITIES_MIN = 0.1
"""Least share of tracks with an identity with which the command succeeds."""


class _Identity(Struct):
    """A row of the file of identities."""

    track: str | int = ""
    identity: str | int = ""
    camera: str | None = None


def add_parser(add: Any) -> None:
    """Add `score`."""
    parser = add(
        description="Scores a topology by the identities of a recording: links between cameras, "
        "predictions of the next camera beside an oracle that is told the identities, and matches "
        "of entries with earlier passages. Events after those that were learned count, if any.",
        epilog="example: camtopod score topology.json events.jsonl identities.csv",
    )
    parser.add_argument("topology", metavar="TOPOLOGY.json", help="as `camtopod learn` writes it")
    parser.add_argument("events", metavar="EVENTS", help="the recording; its events have tracks")
    parser.add_argument(
        "identities",
        metavar="IDENTITIES.csv",
        help="columns track, identity and, unless tracks differ between cameras, camera",
    )


def run(args: argparse.Namespace) -> int:
    """Print the scores. Raises `InputError`."""
    topology = topology_of(args.topology)
    reader = LineReader()
    times = Times()
    lines = once_by_number(reader, recorded(reader, [args.events], times))
    events = [line.event for line in lines]
    if (summary := reader.summary()) is not None:
        print(f"camtopod: {summary}", file=sys.stderr)
    if not events:
        raise InputError(f"no event lines in {args.events}: nothing to score")
    identities = _identities_of(args.identities)

    with ProgressLine() as progress:

        def show(number: int, unit: str) -> None:
            progress.show("%d of %d events %s", number, len(events), unit)

        try:
            result = score(topology, events, identities, show)
        except ValueError as error:
            raise InputError(f"{args.events}, {args.identities}: {error}") from None
    if result.learned:
        print("camtopod: these events were learned: the scores are too good", file=sys.stderr)
    print(result)
    tracks = {(event.camera, event.track) for event in events if event.track is not None}
    count = sum((camera, t) in identities or (None, t) in identities for camera, t in tracks)
    has_few = count < IDENTITIES_MIN * len(tracks)
    if has_few:
        print(
            f"camtopod: only {count} of {len(tracks)} tracks have an identity: links that these do "
            "not show are called false",
            file=sys.stderr,
        )
    cameras = Counter(event.camera for event in events)
    foreign_status = foreign_cameras(args.topology, topology, cameras)
    if (fault := fault_of(times)) is not None:
        print(f"camtopod: {fault}", file=sys.stderr)
        return exits.FAILED
    return reader.status or foreign_status or (exits.FAILED if has_few else exits.DONE)


def _identities_of(path: str) -> dict[tuple[str | None, str], str]:
    """Return identities by camera (None for any) and track. Raises `InputError`."""
    identities: dict[tuple[str | None, str], str] = {}
    for number, row in table_rows_of(path, ("track", "identity"), _Identity):
        identity = str(row.identity)
        if identity and identities.setdefault((row.camera, str(row.track)), identity) != identity:
            raise InputError(
                f"{path}:{number}: track {row.track} has another identity above: give the column "
                "camera, and tracks that do not come again"
            )
    return identities
