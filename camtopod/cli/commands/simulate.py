"""`camtopod simulate`: a made-up camera network, its events and the truth about it."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import IO, Any

from camtopod.cli import exits
from camtopod.cli.terminal import Progress
from camtopod.codec import to_json
from camtopod.records import Event
from camtopod.sim import SimSettings, simulate

BLOCK_LINES = 10_000


def add_parser(subparsers: Any) -> None:
    """Add `simulate`; every option but the files is a setting of `SimSettings`."""
    summary = "a made-up camera network: event lines and the truth about them"
    parser = subparsers.add_parser("simulate", help=summary, description=summary.capitalize() + ".")
    default = SimSettings()
    parser.add_argument(
        "--events",
        required=True,
        metavar="E.jsonl",
        help="event lines go here ('-': standard output)",
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
        (
            "--zone-separation",
            float,
            "least distance of two zones of a camera, fraction of the image",
        ),
        ("--zone-stretch", float, "how many times as long the zones are"),
        ("--fire-doors", int, "cameras with a zone that sees 1 %% of their events"),
        ("--uneven", float, "spread of a way's length in each direction (log scale)"),
        ("--one-way", float, "share of the ways taken in one direction only"),
        ("--u-turn", float, "probability of leaving a view where one came in"),
        ("--speed-sd", float, "spread of the walkers' speeds (log scale)"),
        ("--path-sd", float, "spread of one walker's time over one way (log scale)"),
        ("--position-noise", float, "standard deviation added to positions, fraction of the image"),
        ("--clock-sd", float, "standard deviation of the cameras' clock offsets, seconds"),
        ("--clock-max", float, "clocks of a share of the cameras are off by up to this, seconds"),
        ("--clock-share", float, "that share"),
        ("--rhythm", float, "amplitude of the day/night rhythm, a share of the rate"),
        ("--rhythm-hours", float, "its period, hours"),
        ("--platoons", float, "share of the walkers that come in bunches"),
        ("--platoon-size", float, "walkers in a bunch"),
        ("--platoon-cycle", float, "seconds between bunches at one place"),
        ("--group-share", float, "share of the walkers with companions"),
        ("--loiterers", float, "share of the walkers that linger"),
        ("--slow-share", float, "share of the walkers at less than half the speed"),
        ("--doors-closed", int, "paths that close"),
        ("--close-after-hours", float, "when they close (default half-way)"),
        ("--doors-opened", int, "paths that open"),
        ("--open-after-hours", float, "when they open (default half-way)"),
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
    """Options that are not plain numbers. Only those given are in the parsed arguments."""
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
        help="a camera is turned elsewhere AT seconds after the start; may be repeated",
    )
    for flag, name, help_ in (
        ("--no-links", "linked", "no ways between cameras: everybody appears at one camera only"),
        ("--no-track", "tracks", "events without track"),
        ("--no-positions", "positions", "events without x and y"),
    ):
        parser.add_argument(flag, dest=name, action="store_false", default=absent, help=help_)


def run(args: argparse.Namespace) -> int:
    """Write the files; raises `exits.CommandError` for settings without sense and files it cannot
    write.
    """
    try:
        events, truth = simulate(_given(args))
    except ValueError as error:
        raise exits.CommandError(f"simulate: {error}", exits.USAGE) from None
    try:
        with Progress() as progress:
            if args.events == "-":
                _write(events, sys.stdout.buffer, progress)
            else:
                with Path(args.events).open("wb") as file:
                    _write(events, file, progress)
        if args.truth:
            Path(args.truth).write_bytes(to_json(truth) + b"\n")
    except BrokenPipeError:
        raise
    except OSError as error:
        raise exits.CommandError(
            f"simulate: cannot write {error.filename}: {error.strerror}"
        ) from None
    links = sum(link.relation != "visible" for link in truth.links)
    print(
        f"{len(events)} events of {len(set(truth.identity) - {-1})} walkers past {len(truth.cameras)} cameras"
        f" with {len(truth.zones)} zones, {links} links, {len(truth.pairs)} pairs",
        file=sys.stderr,
    )
    return exits.DONE


def _write(events: list[Event], file: IO[bytes], progress: Progress) -> None:
    """Event lines, a block of them at a time."""
    for begin in range(0, len(events), BLOCK_LINES):
        file.write(
            b"".join(to_json(event) + b"\n" for event in events[begin : begin + BLOCK_LINES])
        )
        progress.show("%d of %d events written", begin, len(events))


def _given(args: argparse.Namespace) -> SimSettings:
    """The settings given on the command line, the others at their defaults."""
    values = {
        name: getattr(args, name) for name in SimSettings.__struct_fields__ if hasattr(args, name)
    }
    return SimSettings(
        **values | {name: tuple(values[name]) for name in ("lost", "moved") if name in values}
    )


def _name(flag: str) -> str:
    return flag.removeprefix("--").replace("-", "_")


def _interval(text: str) -> tuple[str, float, float]:
    try:
        camera, begin, end = text.rsplit(":", 2)
        return camera, float(begin), float(end)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not CAMERA:FROM:TO") from None


def _moment(text: str) -> tuple[str, float]:
    try:
        camera, since = text.rsplit(":", 1)
        return camera, float(since)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not CAMERA:AT") from None
