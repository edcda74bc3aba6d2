"""`camtopod simulate`: a made-up camera network, its events and the truth about it."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from camtopod.cli import exits
from camtopod.codec import to_json
from camtopod.sim.network import SimSettings, simulate


def add_parser(subparsers: Any) -> None:
    """Add `simulate`; every option but the files is a setting of `SimSettings`."""
    summary = "a made-up camera network: event lines and the truth about them"
    parser = subparsers.add_parser("simulate", help=summary, description=summary.capitalize() + ".")
    default = SimSettings()
    parser.add_argument("--events", required=True, metavar="E.jsonl", help="event lines go here ('-': standard output)")
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


def run(args: argparse.Namespace) -> int:
    """Write the files; raises `exits.CommandError` for settings without sense and files it cannot write."""
    values: dict[str, Any] = {
        name: getattr(args, name) for name in SimSettings.__struct_fields__ if hasattr(args, name)
    }
    values |= {"lost": tuple(args.lost), "tracks": not args.no_track, "positions": not args.no_positions}
    try:
        events, truth = simulate(SimSettings(**values))
    except ValueError as error:
        raise exits.CommandError(f"simulate: {error}", exits.USAGE) from None
    lines = b"".join(to_json(event) + b"\n" for event in events)
    try:
        if args.events == "-":
            sys.stdout.buffer.write(lines)
        else:
            Path(args.events).write_bytes(lines)
        if args.truth:
            Path(args.truth).write_bytes(to_json(truth) + b"\n")
    except BrokenPipeError:
        raise
    except OSError as error:
        raise exits.CommandError(f"simulate: cannot write {error.filename}: {error.strerror}") from None
    links = sum(link.relation != "visible" for link in truth.links)
    print(
        f"{len(events)} events of {len(set(truth.identity) - {-1})} walkers past {len(truth.cameras)} cameras"
        f" with {len(truth.zones)} zones, {links} links, {len(truth.pairs)} pairs",
        file=sys.stderr,
    )
    return exits.DONE


def _name(flag: str) -> str:
    return flag.removeprefix("--").replace("-", "_")


def _interval(text: str) -> tuple[str, float, float]:
    try:
        camera, begin, end = text.rsplit(":", 2)
        return camera, float(begin), float(end)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not CAMERA:FROM:TO") from None
