"""Kind of a source by its name, encoding of passwords in URLs, and where streams may be."""

from __future__ import annotations

import os
import re
from typing import Literal
from urllib.parse import quote, unquote

RETRY_SEPARATOR = "; trying again in "
"""Separates the reason why a source gives no frames from the seconds until it is reopened."""
PATHS = {
    "Axis": "/axis-media/media.amp",
    "Bosch": "/rtsp_tunnel",
    "Dahua, Amcrest, Lorex": "/cam/realmonitor?channel=1&subtype=0",
    "Foscam": "/videoMain",
    "Hanwha, Samsung": "/profile2/media.smp",
    "Hikvision, Annke": "/Streaming/Channels/101",
    "Panasonic, i-PRO": "/MediaInput/stream_1",
    "Reolink": "/h264Preview_01_main",
    "Sony": "/video1",
    "TP-Link, Ezviz": "/stream1",
    "Ubiquiti": "/s0",
    "Uniview": "/media/video1",
    "Vivotek": "/live.sdp",
}
"""Path under which cameras offer their large stream, by makers."""
_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://(.*)", re.DOTALL)
_DEVICE = re.compile(r"(?:/dev/video)?([0-9]{1,9})")
_NODE = re.compile(r"/dev/(?:v4l/.+|[^/]+)")
"""Path of a device, or of a link to one, which is not there while the device is unplugged."""
_FILE_URL = re.compile(r"file://(?:localhost(?=/))?", re.IGNORECASE)
_HOST = re.compile(
    r"(?P<name>(?P<address>\[[0-9A-Fa-f:.]+(?:%\w+)?\]|\d+\.\d+\.\d+\.\d+(?=[:/?]|$))"
    r"|[A-Za-z0-9_.-]+)(?P<port>:\d+)?(?=[/?]|$)"
)
_BARE = re.compile(r"rtsps?://(?:.*@)?[^/?@]+/*", re.IGNORECASE)
_ENCODED = re.compile(r"(?:[^%]|%[0-9A-Fa-f]{2})*")


def kind_of(source: str) -> Literal["device", "stream", "file"]:
    """Return the kind of a source: a number is a device, a URL a stream, all else a file path.

    ``file://`` URLs are files, and an SDP file (``.sdp``) describes a stream;
    ``/dev/video0``, or a link to it in ``/dev``, is device 0, also while it is not there.
    """
    is_unplugged = _NODE.fullmatch(source) is not None and not os.path.exists(source)
    if is_unplugged or device_number(source) is not None:
        return "device"
    is_media = is_path(source) and not file_path(source).lower().endswith(".sdp")
    return "file" if is_media else "stream"


def is_path(source: str) -> bool:
    """Return True if the source is the path of a file, or its ``file://`` URL."""
    return device_number(source) is None and scheme_of(source) in ("", "file")


def scheme_of(source: str) -> str:
    """Return the scheme of a URL, in small letters; "" if the source is no URL."""
    match = _SCHEME.match(source.strip())
    return "" if match is None else match[1].lower()


def device_number(source: str) -> int | None:
    """Return the number of a device; None if the source is none."""
    node = os.path.realpath(source) if source.startswith("/dev/") else source
    match = _DEVICE.fullmatch(node)
    return None if match is None else int(match.group(1))


def file_path(source: str) -> str:
    """Return the path of a file, which may be given as a ``file://`` URL of this machine."""
    match = _FILE_URL.match(source.lstrip())
    source = source if match is None else source.lstrip()
    return source if match is None else unquote(source[match.end() :], errors="surrogateescape")


def percent_encoded(url: str) -> str:
    """Return ``url`` with user name and password percent-encoded, and a scheme in small letters.

    White space around it is left out, which no URL has.

    Both may contain ``@``, ``:``, ``/`` and ``?`` as they are. The host is the last text after an
    ``@`` that looks most like one: an IP address before a name with a dot or a port, and these
    before a plain name; but in the query only if there is none before it. What stands before the
    first ``:`` or ``/`` is the host itself if it is an IP address, or if no such text follows; so
    no piece of a password is looked up as a name. Text that is already encoded stays unchanged.
    """
    match = _SCHEME.match(url.strip())
    if match is None:
        return url
    scheme, remainder = match[1].lower(), match[2]
    url = f"{scheme}://{remainder}"
    begins = _HOST.match(remainder)
    if begins is not None and begins["address"]:
        return url

    # Rank each @: by whether a likely host follows, outside of the query, an address, the last.
    ranks = [
        (
            bool(host["address"] or host["port"] or "." in host["name"]),
            "?" not in remainder[: at.start()],
            bool(host["address"]),
            at.start(),
        )
        for at in re.finditer("@", remainder)
        if (host := _HOST.match(remainder, at.end()))
    ]
    is_likely, _, _, end = max(ranks, default=(False, False, False, -1))
    if end < 0 or (begins is not None and not (begins["port"] and is_likely)):
        return url  # no user name
    user, colon, password = remainder[:end].partition(":")
    return f"{scheme}://{_quoted(user)}{colon}{_quoted(password)}{remainder[end:]}"


def _quoted(text: str) -> str:
    return quote(text, safe="%" if _ENCODED.fullmatch(text) else "")


def streams_by_maker(source: str) -> dict[str, str]:
    """Return the URLs to try, by makers, for an ``rtsp://`` URL without a path; else none."""
    if not _BARE.fullmatch(source.strip()):
        return {}
    return {maker: source.strip().rstrip("/") + path for maker, path in PATHS.items()}
