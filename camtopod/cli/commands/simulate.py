"""`camtopod simulate`: simulate a camera network; write its events and their ground truth."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from camtopod.cli import exits
from camtopod.cli.common import counted, open_output
from camtopod.codec import to_json
from camtopod.records import Event
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.sim.truth import CLUTTER, Truth

_NUMBERS = (
    ("cameras", int, "number of cameras"),
    ("hours", float, "length of the recording, hours"),
    ("seed", int, "seed of the random numbers; the same seed gives the same events"),
    ("start", float, "event time at which the recording begins, seconds since the epoch"),
    (
        "objects_per_second",
        float,
        "walkers that enter the network per second (default 0.4 for 12 cameras, in proportion)",
    ),
    ("missed", float, "share of the passages that are not recorded (missed detections)"),
    ("clutter", float, "share of the events that belong to no object"),
    ("overlap_share", float, "overlapping pairs of cameras per camera"),
)
"""Setting of `SimSettings`, its type and its help."""


def add_parser(add: Any) -> None:
    """Add `simulate`."""
    parser = add(
        description="Simulates a camera network, and writes event lines and their ground truth.",
        epilog="example: camtopod simulate --events events.jsonl --truth truth.json --hours 4",
    )
    parser.add_argument(
        "--events",
        required=True,
        metavar="E.jsonl",
        help="write event lines to this file ('-': standard output)",
    )
    parser.add_argument("--truth", metavar="T.json", help="write the ground truth to this file")
    parser.add_argument(
        "--identities",
        metavar="I.csv",
        help="write the walker of each track to this file, which `camtopod score` reads",
    )
    default = SimSettings()
    for name, kind, help_ in _NUMBERS:
        value = getattr(default, name)
        parser.add_argument(
            f"--{name.replace('_', '-')}",
            type=kind,
            default=value,
            metavar=kind.__name__.upper(),
            help=help_ if value is None else f"{help_} (default {value:g})",
        )

    parser.add_argument(
        "--labels",
        type=_shares,
        default={},
        metavar="LABEL=SHARE,...",
        help="labels of the walkers, such as person=0.9,bicycle=0.1; the others have none",
    )


def _shares(text: str) -> dict[str, float]:
    """Return the shares of an option such as ``person=0.9,bicycle=0.1``; raise ValueError."""
    pairs = [part.partition("=") for part in text.split(",")]
    return {name.strip(): float(share) for name, _, share in pairs}


def _identities(events: list[Event], truth: Truth) -> bytes:
    """Return a table of the walker of each track that is not clutter, a row each, as CSV."""
    rows = {
        (event.camera, event.track): walker
        for event, walker in zip(events, truth.identity, strict=True)
        if walker != CLUTTER and event.track is not None
    }
    lines = [f"{camera},{track},{walker}" for (camera, track), walker in rows.items()]
    return "\n".join(["camera,track,identity", *lines, ""]).encode()


def run(args: argparse.Namespace) -> None:
    """Simulate and write the files.

    Raises `exits.CommandError` for invalid settings and files that cannot be written.
    """
    # Simulate.
    try:
        numbers = {name: getattr(args, name) for name, _, _ in _NUMBERS}
        events, truth = simulate(SimSettings(**numbers, labels=args.labels))
    except ValueError as error:
        raise exits.CommandError(f"simulate: {error}", exits.USAGE) from None

    # Write the files.
    with open_output(args.events) as file:
        file.writelines(to_json(event) + b"\n" for event in events)
    if args.truth:
        with open_output(args.truth) as file:
            file.write(to_json(truth) + b"\n")
    if args.identities:
        with open_output(args.identities) as file:
            file.write(_identities(events, truth))

    # Summarise.
    links = sum(link.relation != "visible" for link in truth.links)
    print(
        f"{counted(len(events), 'event')} of "
        f"{counted(len(set(truth.identity) - {-1}), 'walker')} past "
        f"{counted(len(truth.cameras), 'camera')} with {counted(len(truth.zones), 'zone')}, "
        f"{counted(links, 'link')}, {counted(len(truth.pairs), 'camera pair')}",
        file=sys.stderr,
    )
