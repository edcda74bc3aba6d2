"""`camtopod simulate`: a made-up camera network, its events and the truth about it."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from camtopod.codec import to_json
from camtopod.sim.network import SimSettings, simulate

HELP = "a made-up camera network: event lines and the truth about them"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    default = SimSettings()
    parser.add_argument(
        "--events", required=True, metavar="E.jsonl", help="event lines go here ('-': standard output)"
    )
    parser.add_argument("--truth", metavar="T.json", help="the truth goes here")
    for flag, kind, help_ in (
        ("--cameras", int, "number of cameras"),
        ("--hours", float, "length of the recording, hours"),
        ("--seed", int, "same seed, same events"),
        ("--start", float, "event time at which it begins, seconds since the epoch"),
        (
            "--objects-per-second",
            float,
            "walkers that enter the network (default 0.4 for 12 cameras, in proportion)",
        ),
        ("--missed", float, "share of the passages that are not recorded"),
        ("--clutter", float, "share of the events that belong to nobody"),
        ("--overlap-share", float, "overlapping pairs of cameras per camera"),
        ("--u-turn", float, "probability of leaving a view where one came in"),
        ("--speed-sd", float, "spread of the walkers' speeds (log scale)"),
        ("--path-sd", float, "spread of one walker's time over one way (log scale)"),
        ("--position-noise", float, "standard deviation added to positions, fraction of the image"),
        ("--clock-sd", float, "standard deviation of the cameras' clock offsets, seconds"),
        ("--rhythm", float, "amplitude of the day/night rhythm, a share of the rate"),
        ("--rhythm-hours", float, "its period, hours"),
        ("--group-share", float, "share of the walkers with companions"),
        ("--loiterers", float, "share of the walkers that linger"),
        ("--slow-share", float, "share of the walkers at less than half the speed"),
        ("--doors-closed", int, "paths that close"),
        ("--close-after-hours", float, "when they close (default half-way)"),
    ):
        value = getattr(default, _name(flag))
        shown = "" if value is None else f" (default {value:g})"
        parser.add_argument(flag, type=kind, default=value, metavar=kind.__name__.upper(), help=help_ + shown)
    parser.add_argument(
        "--lost",
        type=_interval,
        action="append",
        default=[],
        metavar="CAMERA:FROM:TO",
        help="a camera reports nothing from FROM to TO seconds after the start; may be repeated",
    )
    parser.add_argument("--no-track", action="store_true", help="events without track")
    parser.add_argument("--no-positions", action="store_true", help="events without x and y")


def run(arguments: argparse.Namespace) -> int:
    """Writes the files; exit status as the contract says."""
    values: dict[str, Any] = {
        name: getattr(arguments, name) for name in SimSettings.__struct_fields__ if hasattr(arguments, name)
    }
    values |= {"lost": tuple(arguments.lost), "tracks": not arguments.no_track}
    try:
        settings = SimSettings(**values, positions=not arguments.no_positions)
        events, truth = simulate(settings)
    except ValueError as error:
        print(f"camtopod simulate: {error}", file=sys.stderr)
        return 2
    lines = b"".join(to_json(event) + b"\n" for event in events)
    try:
        if arguments.events == "-":
            sys.stdout.buffer.write(lines)
            sys.stdout.buffer.flush()
        else:
            Path(arguments.events).write_bytes(lines)
        if arguments.truth:
            Path(arguments.truth).write_bytes(to_json(truth) + b"\n")
    except OSError as error:
        print(f"camtopod simulate: cannot write {error.filename}: {error.strerror}", file=sys.stderr)
        return 1
    links = sum(link.relation != "visible" for link in truth.links)
    print(
        f"{len(events)} events of {len(set(truth.identity) - {-1})} walkers past {len(truth.cameras)} cameras"
        f" with {len(truth.zones)} zones, {links} links, {len(truth.pairs)} pairs",
        file=sys.stderr,
    )
    return 0


def _name(flag: str) -> str:
    return flag.removeprefix("--").replace("-", "_")


def _interval(text: str) -> tuple[str, float, float]:
    try:
        camera, begin, end = text.rsplit(":", 2)
        return camera, float(begin), float(end)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not CAMERA:FROM:TO") from None
