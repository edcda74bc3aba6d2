"""What a source is, by its name, and how its password is spelled for FFmpeg."""

from __future__ import annotations

import re
from typing import Literal
from urllib.parse import quote

AGAIN = "; trying again in "
"""Between the reason why a source gives no pictures and the seconds until it is opened anew."""
_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://(.*)", re.DOTALL)
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+)(:\d+)?(?=[/?]|$)")
_ENCODED = re.compile(r"(?:[^%]|%[0-9A-Fa-f]{2})*")


def kind_of(source: str) -> Literal["device", "stream", "file"]:
    """A number is a device, anything with a scheme a stream, the rest the path of a file."""
    if source.isdigit():
        return "device"
    match = _SCHEME.match(source)
    return "stream" if match and match.group(1).lower() != "file" else "file"


def percent_encoded(url: str) -> str:
    """``url`` with the user name and password encoded, which may hold ``@``, ``:`` and ``/`` as
    they are.

    The host begins after the first ``@`` that a host name and perhaps a port follow. What is
    encoded already stays.
    """
    match = _SCHEME.match(url)
    if match is None or _HOST.match(match.group(2)):  # begins with the host: there is no password
        return url
    scheme, rest = match.groups()
    for at in (m.start() for m in re.finditer("@", rest)):
        if _HOST.match(rest, at + 1):
            user, colon, password = rest[:at].partition(":")
            return f"{scheme}://{_quoted(user)}{colon}{_quoted(password)}{rest[at:]}"
    return url


def _quoted(text: str) -> str:
    return quote(text, safe="%" if _ENCODED.fullmatch(text) else "")
