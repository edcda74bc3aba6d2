"""Input formats of `camtopod ingest`: their options, and where their lines come from."""

from __future__ import annotations

import argparse
import contextlib
import re
import threading
from collections import Counter
from collections.abc import Iterator
from typing import Any

from camtopod import mqtt
from camtopod.adapt import ANY_CAMERA, FORMATS, LINE_BYTES_MAX, Adapter, Size, frames
from camtopod.cli import exits
from camtopod.cli.common import camera_id
from camtopod.cli.events import broker_options
from camtopod.cli.events.event_lines import LineReader, open_input
from camtopod.cli.events.file_forms import pieces
from camtopod.cli.events.recording import Times, recorded_as_written, timed
from camtopod.cli.exits import CommandError
from camtopod.records import Event


def _size(text: str) -> tuple[str, Size]:
    """Parse [CAMERA=]WxH; for argparse."""
    match = _SIZE.fullmatch(text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r}: write it like 1280x720 or lobby=1280x720")
    return match[1] or ANY_CAMERA, (int(match[2]), int(match[3]))


def _renaming(text: str) -> tuple[str, str]:
    """Parse NAME=ID; for argparse."""
    name, _, camera = text.rpartition("=")
    if not name:
        raise argparse.ArgumentTypeError(f"{text!r}: write it like 'Front Door=front_door'")
    return name, camera_id(camera)


_OPTIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "size": (
        "width and height in pixels of the pictures that the boxes refer to (of Frigate's detect, "
        "not needed with path_data; of DeepStream's sources, see integrations.md); may be repeated",
        {"metavar": "[CAMERA=]WxH", "type": _size, "action": "append", "default": []},
    ),
    "label": (
        "only objects of this kind (person, car, ...); may be repeated",
        {"metavar": "NAME", "action": "append", "default": []},
    ),
    "tracked": ("ids come from a tracker (gvatrack in the pipeline)", {"action": "store_true"}),
    "camera": (
        "the id of the one camera (default: as the topic or the message names it)",
        {"metavar": "ID", "type": camera_id},
    ),
    "rename": (
        "camera id instead of the other program's name for a camera; may be repeated",
        {"metavar": "NAME=ID", "type": _renaming, "action": "append", "default": []},
    ),
    "fps": ("frames per second", {"type": float, "metavar": "N"}),
    "start": ("event time of the first frame (default 0)", {"type": float, "metavar": "SECONDS"}),
}
"""Option -> what it means, and the parser's arguments."""
_SIZE = re.compile(r"(?:([A-Za-z0-9_.-]{1,64})=)?([1-9][0-9]{0,5})x([1-9][0-9]{0,5})")
"""Value of --size: [CAMERA=]WxH."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the formats and of MQTT."""
    group = parser.add_argument_group("formats")
    for option, (meaning, arguments) in _OPTIONS.items():
        group.add_argument(f"--{option}", help=f"{meaning} ({_formats(option)})", **arguments)
    names = ", ".join(name for name, input_format in FORMATS.items() if input_format.mqtt)
    group = parser.add_argument_group(
        "MQTT",
        f"FILE may be mqtt[s]://[USER@]HOST[:PORT]/PREFIX ({names}); + in PREFIX is any level",
    )
    broker_options.add_options(group)


def events(
    args: argparse.Namespace,
    reader: LineReader,
    times: Times,
    set_aside: Counter[str],
    stack: contextlib.ExitStack,
    stop: threading.Event,
) -> Iterator[Event]:
    """Return the events of the input that the command line names; ``stack`` closes files.

    times: has those of event lines in the end.
    set_aside: of event lines in a file, see `recorded_as_written`.

    Raises `CommandError`.
    """
    adapter = adapter_for(args)
    if args.file.startswith(("mqtt:", "mqtts:")):
        if adapter is None or not FORMATS[args.format].mqtt:
            raise CommandError(f"{args.format} cannot be read from MQTT, give a file", exits.USAGE)
        source = broker_options.broker_of(args, args.file)
        with broker_options.connecting(exits.INPUT):
            messages = mqtt.MessageSubscription(source, adapter.topic, with_topics=True)
        stack.callback(messages.close)
        lines = ((reader.lines_read + 1, text) for text in messages.read(stop, ticks=True))
        return reader.adapted(messages.topic, lines, adapter, live=True)

    if args.password_file or args.ca:
        raise CommandError("--password-file and --ca are for mqtt[s]:// only", exits.USAGE)
    file = open_input(args.file)
    if args.file != "-":
        stack.callback(file.close)
    if adapter is None and file.seekable():
        return recorded_as_written(reader, args.file, file, times, set_aside)
    if adapter is None:
        return timed((line.event for line in reader.lines(args.file, file)), times)
    frame_messages = frames(pieces(args.file, file), LINE_BYTES_MAX, adapter.begins)
    return reader.adapted(args.file, frame_messages, adapter)


def adapter_for(args: argparse.Namespace) -> Adapter | None:
    """Return the adapter of the format; None for event lines. Raises `CommandError`."""
    input_format = FORMATS[args.format]
    for option in _OPTIONS.keys() - {*input_format.options}:
        if getattr(args, option):
            raise CommandError(
                f"--{option} is for {_formats(option)}, not {args.format}", exits.USAGE
            )
    if input_format.make is None:
        return None
    try:
        adapter = input_format.make(args)
    except ValueError as error:
        raise CommandError(str(error), exits.USAGE) from None
    adapter.cameras.new_names = dict(args.rename)
    return adapter


def _formats(option: str) -> str:
    """Return the names of the formats that have an option."""
    return ", ".join(
        name for name, input_format in FORMATS.items() if option in input_format.options
    )
