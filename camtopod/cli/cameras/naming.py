"""The ids of cameras that `camtopod init` is given."""

from __future__ import annotations

import itertools
import re
import sys
from collections.abc import Collection, Sequence
from pathlib import Path
from urllib.parse import urlsplit

from camtopod.cli import exits
from camtopod.cli.exits import CommandError, InputError
from camtopod.records import RESERVED
from camtopod.vision.source import device_number, is_path, percent_encoded

_GIVEN = re.compile(r"(?:([A-Za-z0-9_.-]{1,64})=)?(.+)")
"""Argument of the form [NAME=]SOURCE."""
_LENGTH_MAX = 59
"""Longest name to which a number is added; ids have 64 characters at most."""


def named_sources(arguments: Sequence[str]) -> dict[str, str]:
    """Return source by camera id; ``-`` stands for lines of standard input.

    A source without a name is named after its host, file or device, with a number where that is
    taken. Raises `CommandError`.
    """
    pairs: list[tuple[str, str]] = []
    for argument in arguments:
        lines = sys.stdin if argument == "-" else [argument]
        for text in filter(None, map(str.strip, lines)):
            match = _GIVEN.fullmatch(text)
            if match is None or not text.isprintable():
                raise CommandError(f"{text!a}: a source has printable characters only", exits.USAGE)
            pairs.append((match[1] or "", match[2]))
    if not pairs:
        raise InputError("no camera given on standard input")

    # Names that are given come first: the others make way.
    used_names = {*RESERVED}
    for name, _ in pairs:
        if name in used_names:
            raise CommandError(
                f"{name}: this name is given twice or reserved; use another", exits.USAGE
            )
        if name:
            used_names.add(name)
    cameras = {}
    for name, source in pairs:
        if not name:
            name = free_name(_id_of(source), used_names)
            used_names.add(name)
        cameras[name] = source
    return cameras


def free_name(name: str, used_names: Collection[str]) -> str:
    """Return the name, with a number from 2 on if it is used; a long one is cut for that."""
    numbers = (f"{name[:_LENGTH_MAX]}-{number}" for number in itertools.count(2))
    candidates = itertools.chain([name], numbers)
    return next(candidate for candidate in candidates if candidate not in used_names)


def _id_of(source: str) -> str:
    """Return the id of a camera after its host, file or device; other characters are hyphens."""
    if (number := device_number(source)) is not None:
        return f"device-{number}"
    text = Path(source).stem
    if not is_path(source):
        try:
            text = urlsplit(percent_encoded(source)).hostname or ""
        except ValueError:
            text = ""
    return re.sub(r"[^A-Za-z0-9_]+", "-", text).strip("-")[:_LENGTH_MAX] or "camera"
