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
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+)(:\d+)?(?=[/?]|$)")
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

    Both may contain ``@``, ``:`` and ``/`` as they are. The host begins after the first ``@`` that
    is followed by a host name and optionally a port. Text that is already encoded stays unchanged.
    """
    match = _SCHEME.match(url)
    if match is None or _HOST.match(match.group(2)):  # begins with the host: no password
        return url
    scheme, rest = match.groups()
    for at in (m.start() for m in re.finditer("@", rest)):
        if _HOST.match(rest, at + 1):
            user, colon, password = rest[:at].partition(":")
            return f"{scheme}://{_quoted(user)}{colon}{_quoted(password)}{rest[at:]}"
    return url


def _quoted(text: str) -> str:
    return quote(text, safe="%" if _ENCODED.fullmatch(text) else "")
