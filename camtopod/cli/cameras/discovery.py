"""Find the ONVIF cameras of the local network by WS-Discovery (OASIS, 2009)."""

from __future__ import annotations

import contextlib
import re
import socket
import struct
import time
import uuid
from urllib.parse import unquote, urlsplit

from msgspec import Struct

from camtopod.codec import Rejected
from camtopod.untrusted_xml import all_of, parse_xml, text_of

GROUP = ("239.255.255.250", 3702)
"""Multicast address and port of WS-Discovery."""
SECONDS = 3.0
"""Time for which answers are waited for."""
PROBES = 2
"""Times that each network is asked: a datagram may be lost."""
FOUND_MAX = 1000
"""Most cameras that are found."""
_ANSWER_BYTES_MAX = 65_535
_TEXT_CHARACTERS_MAX = 60
_PROBE = (
    '<?xml version="1.0" encoding="UTF-8"?>'
    '<s:Envelope xmlns:s="http://www.w3.org/2003/05/soap-envelope"'
    ' xmlns:a="http://schemas.xmlsoap.org/ws/2004/08/addressing"'
    ' xmlns:d="http://schemas.xmlsoap.org/ws/2005/04/discovery"'
    ' xmlns:n="http://www.onvif.org/ver10/network/wsdl"><s:Header>'
    "<a:MessageID>urn:uuid:{id}</a:MessageID>"
    "<a:To>urn:schemas-xmlsoap-org:ws:2005:04:discovery</a:To>"
    "<a:Action>http://schemas.xmlsoap.org/ws/2005/04/discovery/Probe</a:Action></s:Header>"
    "<s:Body><d:Probe><d:Types>n:NetworkVideoTransmitter</d:Types></d:Probe></s:Body></s:Envelope>"
)


class FoundCamera(Struct, frozen=True):
    """A camera that has answered."""

    service: str
    """URL of its ONVIF device service."""
    name: str
    """Its maker, model or name, as it says; may be empty."""

    @property
    def host(self) -> str:
        """Its host name or address."""
        return urlsplit(self.service).hostname or ""


def discover(seconds: float = SECONDS, group: tuple[str, int] = GROUP) -> list[FoundCamera]:
    """Ask all networks of this machine for cameras, and return those that answer.

    They are sorted by host. Networks that cannot be asked are left out.

    seconds: time for which answers are waited for.
    group: address and port to ask.
    """
    found: dict[str, FoundCamera] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
        for _ in range(PROBES):
            for index, _ in socket.if_nameindex():
                interface = struct.pack("=4s4si", bytes(4), bytes(4), index)
                with contextlib.suppress(OSError):  # a network that is down, or without IPv4
                    asking.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface)
                    asking.sendto(_PROBE.format(id=uuid.uuid4()).encode(), group)

        deadline = time.monotonic() + seconds
        while len(found) < FOUND_MAX and (left := deadline - time.monotonic()) > 0.0:
            asking.settimeout(left)
            try:
                answer, (address, _) = asking.recvfrom(_ANSWER_BYTES_MAX)
            except OSError:  # the time is over
                break
            for camera in _cameras_of(answer, address):
                found.setdefault(camera.host, camera)
    return sorted(found.values(), key=lambda camera: camera.host)


def _cameras_of(answer: bytes, address: str) -> list[FoundCamera]:
    """Return the cameras of an answer; none if it is malformed.

    address: where the answer comes from; of several addresses of a camera this one is preferred.
    """
    try:
        root = parse_xml(answer)
    except Rejected:
        return []
    cameras = []
    for match in all_of(root, "ProbeMatch"):
        urls = [url for url in text_of(match, "XAddrs").split() if _is_http(url)]
        urls.sort(key=lambda url: urlsplit(url).hostname != address)
        if urls:
            cameras.append(FoundCamera(urls[0], _name(text_of(match, "Scopes").split())))
    return cameras


def _is_http(url: str) -> bool:
    try:
        parts = urlsplit(url)
        return parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        return False


def _name(scopes: list[str]) -> str:
    """Return a camera's name and hardware from its scopes."""
    said = []
    for kind in ("name", "hardware"):
        for scope in scopes:
            match = re.fullmatch(rf"onvif://www\.onvif\.org/{kind}/(.+)", scope, re.IGNORECASE)
            if match and (text := unquote(match[1]).strip()) not in said:
                said.append(text)
    return " ".join(said)[:_TEXT_CHARACTERS_MAX]
