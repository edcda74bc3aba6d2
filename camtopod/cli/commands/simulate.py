"""`camtopod simulate`: simulate a camera network; write its events and their ground truth."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from camtopod.cli import exits
from camtopod.cli.common import open_output, writing
from camtopod.cli.terminal import Progress
from camtopod.codec import to_json
from camtopod.sim.simulation import SimSettings, simulate

BLOCK_LINES = 10_000
"""Event lines written at a time."""


def add_parser(subparsers: Any) -> None:
    """Add `simulate`; every option except the files is a setting of `SimSettings`."""
    parser = subparsers.add_parser(
        "simulate",
        help="simulate a camera network: event lines and their ground truth",
        description="Simulates a camera network, and writes event lines and their ground truth.",
        epilog="example: camtopod simulate --events events.jsonl --truth truth.json --hours 4",
    )
    default = SimSettings()
    parser.add_argument(
        "--events",
        required=True,
        metavar="E.jsonl",
        help="write event lines to this file ('-': standard output)",
    )
    parser.add_argument("--truth", metavar="T.json", help="write the ground truth to this file")
    # Options that set one number of `SimSettings` each.
    for flag, kind, help_ in (
        ("--cameras", int, "number of cameras"),
        ("--hours", float, "length of the recording, hours"),
        ("--seed", int, "seed of the random numbers; the same seed gives the same events"),
        ("--start", float, "event time at which the recording begins, seconds since the epoch"),
        (
            "--objects-per-second",
            float,
            "walkers that enter the network per second (default 0.4 for 12 cameras, in proportion)",
        ),
        ("--missed", float, "share of the passages that are not recorded (missed detections)"),
        ("--clutter", float, "share of the events that belong to no object"),
        ("--overlap-share", float, "overlapping pairs of cameras per camera"),
        (
            "--zone-separation",
            float,
            "least distance of two zones of a camera, fraction of the image",
        ),
        ("--zone-stretch", float, "factor on the length of the zones"),
        ("--fire-doors", int, "cameras with a zone that has 1 %% of their events"),
        ("--uneven", float, "spread of a path's length in each direction (log scale)"),
        ("--one-way", float, "share of the paths walked in one direction only"),
        ("--clock-sd", float, "standard deviation of the cameras' clock offsets, seconds"),
        ("--clock-max", float, "largest further clock offset of some of the cameras, seconds"),
        ("--clock-share", float, "share of the cameras with such an offset"),
        ("--rhythm", float, "amplitude of the day/night rhythm, a share of the rate"),
        ("--rhythm-hours", float, "period of the day/night rhythm, hours"),
        ("--platoons", float, "share of the walkers that come in platoons"),
        ("--platoon-size", float, "mean number of walkers in a platoon"),
        ("--group-share", float, "share of the walkers with companions"),
        ("--loiterers", float, "share of the walkers with 5 to 30 times the dwell time"),
        ("--slow-share", float, "share of the walkers at less than half the speed"),
        ("--doors-closed", int, "number of paths that close half-way"),
        ("--doors-opened", int, "number of paths that open half-way"),
    ):
        value = getattr(default, _name(flag))
        shown = "" if value is None else f" (default {value:g})"
        parser.add_argument(
            flag,
            type=kind,
            default=argparse.SUPPRESS,
            metavar=kind.__name__.upper(),
            help=help_ + shown,
        )
    _add_special(parser)


def _add_special(parser: argparse.ArgumentParser) -> None:
    """Add options that are not plain numbers; only those given are in the parsed arguments."""
    absent = argparse.SUPPRESS
    parser.add_argument(
        "--lost",
        type=_interval,
        action="append",
        default=absent,
        metavar="CAMERA:FROM:TO",
        help="a camera reports nothing from FROM to TO seconds after the start; may be repeated",
    )
    parser.add_argument(
        "--moved",
        type=_moment,
        action="append",
        default=absent,
        metavar="CAMERA:AT",
        help="a camera is turned AT seconds after the start, so its zones move; may be repeated",
    )
    for flag, name, help_ in (
        ("--no-links", "linked", "no paths between cameras: each walker appears in one view only"),
        ("--no-track", "tracks", "events without track"),
        ("--no-positions", "positions", "events without x and y"),
    ):
        parser.add_argument(flag, dest=name, action="store_false", default=absent, help=help_)


def run(args: argparse.Namespace) -> int:
    """Simulate and write the files.

    Raises `exits.CommandError` for invalid settings and files that cannot be written.
    """
    # Simulate.
    try:
        events, truth = simulate(_given(args))
    except ValueError as error:
        raise exits.CommandError(f"simulate: {error}", exits.USAGE) from None

    # Write the files.
    with Progress() as progress, open_output(args.events) as file:
        for begin in range(0, len(events), BLOCK_LINES):
            block = events[begin : begin + BLOCK_LINES]
            file.write(b"".join(to_json(event) + b"\n" for event in block))
            progress.show("%d of %d events written", begin, len(events))
    if args.truth:
        with writing(args.truth):
            Path(args.truth).write_bytes(to_json(truth) + b"\n")

    # Summarise.
    links = sum(link.relation != "visible" for link in truth.links)
    print(
        f"{len(events)} events of {len(set(truth.identity) - {-1})} walkers past "
        f"{len(truth.cameras)} cameras with {len(truth.zones)} zones, {links} links, "
        f"{len(truth.pairs)} camera pairs",
        file=sys.stderr,
    )
    return exits.DONE


def _given(args: argparse.Namespace) -> SimSettings:
    """Return the settings with those given on the command line."""
    values = {
        name: getattr(args, name) for name in SimSettings.__struct_fields__ if hasattr(args, name)
    }
    return SimSettings(
        **values | {name: tuple(values[name]) for name in ("lost", "moved") if name in values}
    )


def _name(flag: str) -> str:
    """Return the name of the setting that an option sets."""
    return flag.removeprefix("--").replace("-", "_")


def _interval(text: str) -> tuple[str, float, float]:
    """Parse CAMERA:FROM:TO."""
    try:
        camera, begin, end = text.rsplit(":", 2)
        return camera, float(begin), float(end)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not CAMERA:FROM:TO") from None


def _moment(text: str) -> tuple[str, float]:
    """Parse CAMERA:AT."""
    try:
        camera, since = text.rsplit(":", 1)
        return camera, float(since)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not CAMERA:AT") from None
