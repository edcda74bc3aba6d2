"""Kind of a source by its name, and encoding of passwords in URLs for FFmpeg."""

from __future__ import annotations

import os
import re
from typing import Literal
from urllib.parse import quote, unquote

RETRY_SEPARATOR = "; trying again in "
"""Separates the reason why a source gives no frames from the seconds until it is reopened."""
_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://(.*)", re.DOTALL)
_DEVICE = re.compile(r"(?:/dev/video)?([0-9]+)")
_FILE_URL = re.compile(r"file://(?:localhost(?=/))?", re.IGNORECASE)
_HOST = re.compile(
    r"(?P<name>(?P<address>\[[0-9A-Fa-f:.]+(?:%\w+)?\]|\d+\.\d+\.\d+\.\d+(?=[:/?]|$))"
    r"|[A-Za-z0-9_.-]+)(?P<port>:\d+)?(?=[/?]|$)"
)
_ENCODED = re.compile(r"(?:[^%]|%[0-9A-Fa-f]{2})*")


def kind_of(source: str) -> Literal["device", "stream", "file"]:
    """Return the kind of a source: a number is a device, a URL a stream, all else a file path.

    ``file://`` URLs are files; ``/dev/video0``, or a link to it in ``/dev``, is device 0.
    """
    if device_number(source) is not None:
        return "device"
    match = _SCHEME.match(source)
    if match is None or match.group(1).lower() == "file":
        return "file"
    return "stream"


def device_number(source: str) -> int | None:
    """Return the number of a device; None if the source is none."""
    node = os.path.realpath(source) if source.startswith("/dev/") else source
    match = _DEVICE.fullmatch(node)
    return None if match is None else int(match.group(1))


def file_path(source: str) -> str:
    """Return the path of a file, which may be given as a ``file://`` URL of this machine."""
    match = _FILE_URL.match(source)
    return source if match is None else unquote(source[match.end() :], errors="surrogateescape")


def percent_encoded(url: str) -> str:
    """Return ``url`` with user name and password percent-encoded.

    Both may contain ``@``, ``:``, ``/`` and ``?`` as they are. The host is the last text after an
    ``@`` that looks most like one: an IP address before a name with a dot or a port, and these
    before a plain name; but in the query only if there is none before it. What stands before the
    first ``:`` or ``/`` is the host itself if it is an IP address, or if no such text follows; so
    no piece of a password is looked up as a name. Text that is already encoded stays unchanged.
    """
    match = _SCHEME.match(url)
    if match is None:
        return url
    scheme, rest = match.groups()
    begins = _HOST.match(rest)
    if begins is not None and begins["address"]:
        return url

    # Rank the @ by what follows each.
    hosts = {
        at.start(): host
        for at in re.finditer("@", rest)
        if (host := _HOST.match(rest, at.end())) is not None
    }

    def rank(at: int) -> tuple[bool, bool, bool, int]:
        host = hosts[at]
        named = "." in host["name"] or host["port"] is not None
        likely = host["address"] is not None or named
        return likely, "?" not in rest[:at], host["address"] is not None, at

    at = max(hosts, key=rank, default=None)
    if at is None or (begins is not None and not (begins["port"] and rank(at)[0])):
        return url  # no user name
    user, colon, password = rest[:at].partition(":")
    return f"{scheme}://{_quoted(user)}{colon}{_quoted(password)}{rest[at:]}"


def _quoted(text: str) -> str:
    return quote(text, safe="%" if _ENCODED.fullmatch(text) else "")
