"""Input formats of `camtopod ingest`: their options, and where their lines come from."""

from __future__ import annotations

import argparse
import contextlib
import re
import threading
from collections.abc import Iterator

from camtopod import mqtt
from camtopod.adapt import (
    ANY_CAMERA,
    LINE_BYTES_MAX,
    Adapter,
    Axis,
    DeepStream,
    Frigate,
    Mot,
    Onvif,
    SceneScape,
    Size,
)
from camtopod.cli import exits
from camtopod.cli.events import broker_options
from camtopod.cli.events.event_lines import LineReader, numbered, open_input
from camtopod.cli.exits import CommandError
from camtopod.config import RESERVED
from camtopod.records import CAMERA_PATTERN, Event

FORMATS = ("jsonl", "frigate", "mot", "scenescape", "axis", "onvif", "deepstream")
"""Names of the formats."""
_OPTIONS = {
    "size": ("frigate", "mot", "scenescape", "deepstream"),
    "label": ("frigate", "scenescape", "axis", "onvif", "deepstream"),
    "tracked": ("scenescape",),
    "camera": ("mot", "axis", "onvif", "deepstream"),
    "fps": ("mot",),
    "start": ("mot",),
}
"""Option -> formats that have it."""
_SIZE = re.compile(r"(?:([A-Za-z0-9_.-]{1,64})=)?([1-9][0-9]{0,5})x([1-9][0-9]{0,5})")
"""Value of --size: [CAMERA=]WxH."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the formats and of MQTT."""
    group = parser.add_argument_group("formats")
    group.add_argument(
        "--size",
        metavar="[CAMERA=]WxH",
        action="append",
        default=[],
        help="size in pixels of the pictures that the boxes refer to (frigate: detect width and "
        "height, not needed if Frigate sends path_data; deepstream: nvstreammux width and height); "
        "may be repeated",
    )
    group.add_argument(
        "--label",
        metavar="NAME",
        action="append",
        default=[],
        help="all but mot and jsonl: only objects of this kind (person, car, ...); may be repeated",
    )
    group.add_argument(
        "--tracked",
        action="store_true",
        help="scenescape: ids come from a tracker (gvatrack in the pipeline)",
    )
    group.add_argument(
        "--camera",
        metavar="ID",
        help="mot: the camera's id; axis, onvif, deepstream: the id of the one camera (default: as "
        "the topic or the message names it)",
    )
    group.add_argument("--fps", type=float, metavar="N", help="mot: frames per second")
    group.add_argument(
        "--start",
        type=float,
        metavar="SECONDS",
        help="mot: event time of the first frame (default 0)",
    )
    group = parser.add_argument_group(
        "MQTT",
        "FILE may be mqtt[s]://[USER@]HOST[:PORT]/PREFIX (frigate, scenescape, axis, onvif, "
        "deepstream)",
    )
    broker_options.add_options(group)


def events(
    args: argparse.Namespace, reader: LineReader, stack: contextlib.ExitStack, stop: threading.Event
) -> Iterator[Event]:
    """Return the events of the input that the command line names; ``stack`` closes files.

    Raises `CommandError`.
    """
    adapter = adapter_for(args)
    if args.file.startswith(("mqtt:", "mqtts:")):
        if adapter is None or not adapter.topic:
            raise CommandError(f"{args.format} cannot be read from MQTT, give a file", exits.USAGE)
        messages = _messages(args, adapter.topic)
        stack.callback(messages.close)
        if isinstance(adapter, Axis | Onvif | DeepStream):  # cameras that may be silent
            lines = enumerate(messages.read(stop, ticks=True), 1)
            return reader.adapted(messages.topic, lines, adapter, adapter.silent)
        return reader.adapted(messages.topic, enumerate(messages.read(stop), 1), adapter)
    if args.password_file or args.ca:
        raise CommandError("--password-file and --ca are for mqtt[s]:// only", exits.USAGE)
    file = open_input(args.file)
    if args.file != "-":
        stack.callback(file.close)
    if adapter is None:
        return (line.event for line in reader.lines(args.file, file))
    return reader.adapted(args.file, numbered(file, LINE_BYTES_MAX), adapter)


def adapter_for(args: argparse.Namespace) -> Adapter | None:
    """Return the adapter of the format; None for event lines. Raises `CommandError`."""
    for option, formats in _OPTIONS.items():
        if getattr(args, option) not in (None, False, []) and args.format not in formats:
            raise CommandError(
                f"--{option} is for {' and '.join(formats)}, not {args.format}", exits.USAGE
            )
    if args.camera in RESERVED:
        raise CommandError(
            f"--camera {args.camera}: this name is reserved on the bus, use another", exits.USAGE
        )
    if args.camera is not None and not re.match(CAMERA_PATTERN, args.camera):
        raise CommandError(
            f"--camera {args.camera!r}: use 1 to 64 of the characters A-Z a-z 0-9 _ . -",
            exits.USAGE,
        )
    sizes = _sizes(args.size)
    if args.format == "axis":
        return Axis(args.camera, args.label)
    if args.format == "onvif":
        return Onvif(args.camera, args.label)
    if args.format == "deepstream":
        return DeepStream(sizes, args.camera, args.label)
    if args.format == "frigate":
        return Frigate(sizes, args.label)
    if args.format == "scenescape":
        return SceneScape(sizes, args.label, args.tracked)
    return _mot(args, sizes) if args.format == "mot" else None


def _mot(args: argparse.Namespace, sizes: dict[str, Size]) -> Mot:
    """Return the adapter of MOTChallenge files, which needs a camera, a frame rate and a size."""
    missing = [
        f"--{name}" for name in ("camera", "fps", "size") if getattr(args, name) in (None, [])
    ]
    if missing:
        raise CommandError(f"mot needs {' and '.join(missing)}", exits.USAGE)
    size = sizes.get(args.camera) or sizes.get(ANY_CAMERA)
    if size is None:
        raise CommandError(
            f"--size {args.size[0]} is for another camera than {args.camera}", exits.USAGE
        )
    try:
        return Mot(args.camera, size, args.fps, args.start or 0.0)
    except ValueError as error:
        raise CommandError(str(error), exits.USAGE) from None


def _sizes(given: list[str]) -> dict[str, Size]:
    """Return camera -> size in pixels, from the values of --size."""
    sizes = {}
    for text in given:
        match = _SIZE.fullmatch(text)
        if match is None:
            raise CommandError(
                f"--size {text!r}: write it like 1280x720 or lobby=1280x720", exits.USAGE
            )
        sizes[match[1] or ANY_CAMERA] = (int(match[2]), int(match[3]))
    return sizes


def _messages(args: argparse.Namespace, topic: str) -> mqtt.MessageSubscription:
    """Subscribe to ``topic`` at the broker."""
    source = broker_options.broker_of(args, args.file)
    with broker_options.connecting(exits.INPUT):
        return mqtt.MessageSubscription(source, topic, with_topics=topic == "#")
