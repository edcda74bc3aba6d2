"""The ids of cameras that `camtopod init` is given."""

from __future__ import annotations

import ipaddress
import re
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import urlsplit

from camtopod.cli import exits
from camtopod.cli.exits import CommandError, InputError
from camtopod.config import RESERVED
from camtopod.redact import holds_secret, redact
from camtopod.vision.source import kind_of, percent_encoded

_GIVEN = re.compile(r"([A-Za-z0-9_.-]{1,64})=(.+)", re.DOTALL)
"""Argument of the form NAME=SOURCE."""
_NAMED_URL = re.compile(r"[^=:/]+=[a-z]+://")
"""A URL with a name before it."""


def named_sources(arguments: Sequence[str]) -> list[tuple[str, str]]:
    """Return (name or "", source) of each argument; ``-`` stands for lines of standard input."""
    found: list[tuple[str, str]] = []
    for argument in arguments:
        for line in sys.stdin if argument == "-" else [argument]:
            if not (text := line.strip()).isprintable():
                raise CommandError(f"{text!a}: a source has printable characters only", exits.USAGE)
            match = _GIVEN.fullmatch(text)
            if match is None and _NAMED_URL.match(text):
                raise CommandError(
                    f"{redact(text)}: a name has 1 to 64 of the characters A-Z a-z 0-9 _ . -",
                    exits.USAGE,
                )
            if match is not None:
                found.append((match[1], match[2]))
            elif text:
                found.append(("", text))
    if arguments and not found:
        raise InputError("no camera given on standard input")
    return found


def with_names(given: Sequence[tuple[str, str]]) -> dict[str, str]:
    """Return id -> source.

    A source without a name is named after its host or path, with a number where the name is taken.
    """
    short = Counter(_short(source) for name, source in given if not name)
    cameras: dict[str, str] = {}
    for name, source in given:
        if name in (*cameras, *RESERVED, ".", ".."):
            raise CommandError(
                f"{name}: this name is given twice or reserved; use another", exits.USAGE
            )
        if not name:
            own = _short(source)
            own = own if short[own] == 1 else _long(source)
            taken = {*cameras, *RESERVED, *(name for name, _ in given)}
            numbers = (f"{own[: 64 - 5]}-{number}" for number in range(2, len(given) + 3))
            name = next(one for one in (own, *numbers) if one not in taken)
        cameras[name] = source
    return cameras


def _short(source: str) -> str:
    """Return a camera's id from its host, or from its path if the host is this machine."""
    kind = kind_of(source)
    if kind == "device":
        return f"device-{int(source)}"
    if kind == "file":
        return _id(Path(source).stem)
    host = _host(source)
    try:
        local = ipaddress.ip_address(host).is_loopback
    except ValueError:
        host = host.partition(".")[0]
        local = host == "localhost"
    return _id(_path(source) if local else host)


def _long(source: str) -> str:
    """Return a longer id, with the path, for cameras that share a host."""
    if kind_of(source) != "stream":
        return _short(source)
    return _id(f"{_host(source)} {_path(source)}")


def _host(source: str) -> str:
    """Return the host of a URL, "" if it has none."""
    try:
        return urlsplit(percent_encoded(source)).hostname or ""
    except ValueError:
        return ""


def _path(source: str) -> str:
    """Return the path of a URL, "" if it contains a secret."""
    try:
        path = urlsplit(percent_encoded(source)).path
    except ValueError:
        return ""
    return "" if holds_secret(f"rtsp://host{path}") else path


def _id(text: str) -> str:
    """Return ``text`` as an id: other characters become hyphens."""
    return re.sub(r"[^A-Za-z0-9_]+", "-", text).strip("-")[:64] or "camera"
