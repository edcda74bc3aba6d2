"""Ask a camera for its streams by ONVIF (Core and Media Service Specifications, version 10).

The password is sent as the digest of a WS-Security username token, or as an HTTP digest where the
camera asks for that; never in the clear, and to the host that was given alone.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import http.client
import ipaddress
import re
import secrets
import socket
import threading
import time
from datetime import UTC, datetime
from urllib.parse import quote, unquote, urlsplit
from xml.etree.ElementTree import Element
from xml.sax.saxutils import escape

from msgspec import Struct

from camtopod.cli.cameras.http_digest import Challenge, challenges
from camtopod.codec import Rejected
from camtopod.redact import redact
from camtopod.serve.runtime import wall
from camtopod.untrusted_xml import DOCUMENT_BYTES_MAX, all_of, parse_xml, text_of
from camtopod.vision.source import percent_encoded

SCHEME = "onvif"
"""Scheme of a source that stands for the streams of an ONVIF camera."""
DEVICE_PATH = "/onvif/device_service"
"""Usual path of the device service."""
SECONDS = 5.0
"""Longest time for one answer, however slowly it comes."""
SECONDS_ALL = 30.0
"""Longest time for all answers of a camera."""
EXCHANGES_MAX = 3
"""Most requests for one answer: without a digest, with one, and with one for a later nonce."""
_URL = re.compile(
    r"(\w[\w+.-]*://)"
    r"([^/?#]*@)?"  # login
    r"(\[[0-9A-Fa-f:.]+\]|[^/?#@:\[\]]+)(:\d+)?"
    r"([/?#].*)?"
)
_DEVICE = "http://www.onvif.org/ver10/device/wsdl"
_MEDIA = "http://www.onvif.org/ver10/media/wsdl"
_SCHEMA = "http://www.onvif.org/ver10/schema"
_SECURITY = "http://docs.oasis-open.org/wss/2004/01/oasis-200401-wss-"


class OnvifError(Exception):
    """The camera cannot be asked; ``str()`` says why, and what to do."""


class Stream(Struct, frozen=True):
    """A stream that a camera offers; figures are 0 if it does not say them."""

    url: str
    """RTSP URL with user name and password."""
    width: int
    height: int
    fps: float
    video_source: str = ""
    """Token of the lens, or of a recorder's channel, that it shows; "" if the camera names none."""
    problem: str = ""
    """Why there is no URL; "" if there is one."""
    remark: str = ""
    """Remark on the URL, without secrets."""
    other_url: str = ""
    """URL to try if this one cannot be opened; "" for none."""


def streams(source: str) -> list[Stream]:
    """Return the streams of a camera, in its own order; the first one is usually the largest.

    source: ``onvif://[USER[:PASSWORD]@]HOST[:PORT][/PATH]``.

    Raises `OnvifError`, also if none has a URL.
    """
    camera = _Camera(source)
    media = camera.media_service()
    result = []
    for profile in all_of(camera.ask(media, f'<GetProfiles xmlns="{_MEDIA}"/>'), "Profiles"):
        for encoder in all_of(profile, "VideoEncoderConfiguration"):  # else sound or metadata only
            place, problem = _StreamUrl(), ""
            try:
                place = camera.stream_url(media, profile.get("token", ""))
            except OnvifError as error:
                problem = str(error)
            width, height, fps = (
                int(re.sub(r"\D.*", "", text_of(encoder, name)) or 0)
                for name in ("Width", "Height", "FrameRateLimit")
            )
            result.append(
                Stream(
                    place.url,
                    width,
                    height,
                    fps,
                    _video_source(profile),
                    problem,
                    place.remark,
                    place.other_url,
                )
            )
    if not result:
        raise OnvifError("the camera offers no video by ONVIF")
    if all(stream.problem for stream in result):
        raise OnvifError(result[0].problem)
    return result


def _video_source(profile: Element) -> str:
    """Return the token of a profile's video source; several configurations may crop one source."""
    for configuration in all_of(profile, "VideoSourceConfiguration"):
        return text_of(configuration, "SourceToken") or configuration.get("token", "")
    return ""


class _StreamUrl(Struct):
    """Where a stream is; fields as those of `Stream`."""

    url: str = ""
    remark: str = ""
    other_url: str = ""


class _Answer(Struct):
    """Status, content and challenges (``WWW-Authenticate``, the strongest first) of an answer."""

    status: int
    content: bytes
    challenges: list[Challenge]

    @property
    def is_refusal(self) -> bool:
        """True if the camera wants another login, or one at all."""
        faults = (b"NotAuthorized", b"FailedAuth")
        return self.status in (401, 403) or (
            self.status >= 300 and any(fault in self.content for fault in faults)
        )


class _Camera:
    """A camera that is asked; ``source`` as for `streams`."""

    def __init__(self, source: str) -> None:
        try:
            parts = urlsplit(percent_encoded(source))
            self._address = parts.netloc.rpartition("@")[2]
            self._host = parts.hostname or ""
            self._user = unquote(parts.username or "")
            self._password = unquote(parts.password or "")
        except ValueError:
            raise OnvifError("write it like onvif://USER:PASSWORD@HOST") from None
        self._deadline = time.monotonic() + SECONDS_ALL
        self._device = parts.path.rstrip("/") or DEVICE_PATH
        self._challenges: list[Challenge] = []
        self._challenge: Challenge | None = None
        self._ahead = self._clock_ahead()

    def media_service(self) -> str:
        """Return the path of the media service, at the host that was given."""
        body = self.ask(
            self._device,
            f'<GetCapabilities xmlns="{_DEVICE}"><Category>Media</Category></GetCapabilities>',
        )
        for media in all_of(body, "Media"):
            if match := re.fullmatch(r"\w+://[^/]+(/.+)", text_of(media, "XAddr")):
                return match[1]
        raise OnvifError("the camera names no media service")

    def stream_url(self, media: str, profile: str) -> _StreamUrl:
        """Return where the stream of a profile is. Raises `OnvifError`.

        media: path of the media service.
        profile: token of the profile.
        """
        answer = self.ask(
            media,
            f'<GetStreamUri xmlns="{_MEDIA}"><StreamSetup>'
            f'<Stream xmlns="{_SCHEMA}">RTP-Unicast</Stream>'
            f'<Transport xmlns="{_SCHEMA}"><Protocol>RTSP</Protocol></Transport></StreamSetup>'
            f"<ProfileToken>{escape(profile)}</ProfileToken></GetStreamUri>",
        )
        return self._url_to_try(text_of(answer, "Uri"))

    def _url_to_try(self, url: str) -> _StreamUrl:
        """Return where the stream is that the camera names, with user name and password.

        Another host must not get them. It may be the address behind a router, or 0.0.0.0: the host
        that was given takes its place.

        Raises `OnvifError` if it is no URL of a host.
        """
        match = _URL.fullmatch(url)
        if match is None:
            raise OnvifError(
                f"the camera names no URL of a stream, but {redact(url)!r}: give the stream's "
                "rtsp:// URL"
            )
        scheme, login, host, port, path = match.groups("")
        plain_host = host.strip("[]")
        is_elsewhere = not _addresses(plain_host) & _addresses(self._host)
        if is_elsewhere:
            host = f"[{self._host}]" if ":" in self._host else self._host
        is_ours = bool(self._user and not login)
        if is_ours:
            login = f"{quote(self._user, safe='')}:{quote(self._password, safe='')}@"
            path = path.replace("@", "%40")  # one @, before the host
        result = _StreamUrl(f"{scheme}{login}{host}{port}{path}")
        if is_elsewhere:
            result.remark = (
                f"the camera names a stream at another host, {redact(url)}; the host that answered "
                "is tried in its place"
            )
            if not is_ours and not _is_this_machine(plain_host):
                result.other_url = url
        return result

    def ask(self, path: str, body: str) -> Element:
        """Send a request and return the answer's document. Raises `OnvifError`."""
        try:
            answer = self._send(path, body)
            if answer.status < 300:
                return parse_xml(answer.content)
            reason = f"status {answer.status}"
            if answer.is_refusal:
                raise OnvifError(self._refusal())
        except (OSError, ValueError, http.client.HTTPException, Rejected) as error:
            reason = str(error)
        raise OnvifError(f"no answer by ONVIF at http://{self._address}{path}: {reason}")

    def _send(self, path: str, body: str) -> _Answer:
        """Return the answer to a request, sent with the login that the camera takes.

        That is a username token, until it refuses this and has asked for a digest. No login is sent
        again that was refused: a camera may lock a user out. Raises as `_exchange`.
        """
        is_new = False
        for _ in range(EXCHANGES_MAX):
            if self._challenge is None:
                answer = self._exchange(path, _envelope(body, self._token()))
            else:
                authorization = self._challenge.authorization(
                    self._user, self._password, "POST", path
                )
                answer = self._exchange(path, _envelope(body), authorization)
            if not answer.is_refusal or not self._user:
                break
            challenge = next(iter(self._challenges), None)
            if challenge is None or challenge.strength < 0:
                break
            if is_new and not (answer.challenges and challenge.is_stale):
                break
            self._challenge, is_new = challenge, True
        return answer

    def _refusal(self) -> str:
        """Return why the camera refuses to answer, as far as it is known."""
        if not self._user:
            return "the camera asks for a login: write onvif://USER:PASSWORD@HOST"
        if self._challenge is None and self._challenges:
            names = ", ".join(challenge.name for challenge in self._challenges)
            return (
                f"the camera takes no username token and asks for a login by {names}, which this "
                "program does not offer: give the stream's rtsp:// URL"
            )
        if self._challenge is None and self._ahead is None:
            return (
                "the camera refuses the login: the user name or password is wrong, or the camera's "
                "clock, which it does not tell, differs from this machine's"
            )
        return "the camera refuses the user name or password"

    def _exchange(self, path: str, envelope: bytes, authorization: str = "") -> _Answer:
        """Send one request and return its answer, as far as it is read.

        One deadline bounds the whole: each byte renews a socket's own timeout. Raises `OSError`,
        `ValueError` and `http.client.HTTPException`.
        """
        seconds = min(SECONDS, self._deadline - time.monotonic())
        if seconds <= 0.0:
            raise TimeoutError("it answers too slowly")
        connection = http.client.HTTPConnection(self._address, timeout=seconds)
        with contextlib.closing(connection):
            connection.connect()
            deadline = time.monotonic() + seconds
            timer = threading.Timer(seconds, _shut, [connection.sock])
            timer.start()
            try:
                headers = {"Content-Type": b"application/soap+xml; charset=utf-8"}
                if authorization:
                    headers["Authorization"] = authorization.encode()
                connection.request("POST", path, envelope, headers)
                answer = connection.getresponse()
                content = answer.read(DOCUMENT_BYTES_MAX + 1)
            finally:
                timer.cancel()
                if time.monotonic() >= deadline:
                    raise TimeoutError(f"no whole answer within {seconds:.0f} s")
        if answer.status != 401:
            return _Answer(answer.status, content, [])
        offers = challenges(answer.headers.get_all("WWW-Authenticate", []))
        self._challenges = offers or self._challenges
        return _Answer(answer.status, content, offers)

    def _clock_ahead(self) -> float | None:
        """Return by how many seconds the camera's clock is ahead, as it refuses other times.

        None if it is unknown, for whatever reason. No login is sent.
        """
        names = ("Year", "Month", "Day", "Hour", "Minute", "Second")
        question = _envelope(f'<GetSystemDateAndTime xmlns="{_DEVICE}"/>')
        with contextlib.suppress(
            OSError, ValueError, OverflowError, http.client.HTTPException, Rejected
        ):
            body = parse_xml(self._exchange(self._device, question).content)
            for utc in all_of(body, "UTCDateTime"):
                year, month, day, hour, minute, second = (int(text_of(utc, name)) for name in names)
                moment = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
                return moment.timestamp() - wall()
        return None

    def _token(self) -> str:
        """Return the header with the username token (WS-Security UsernameToken Profile 1.0).

        Empty without a user. Where the camera's time is unknown, it is this machine's.
        """
        if not self._user:
            return ""
        nonce = secrets.token_bytes(16)
        creation = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(wall() + (self._ahead or 0.0)))
        digest = hashlib.sha1(nonce + creation.encode() + self._password.encode()).digest()
        return (
            f'<Security s:mustUnderstand="1" xmlns="{_SECURITY}wssecurity-secext-1.0.xsd">'
            f"<UsernameToken><Username>{escape(self._user)}</Username>"
            f'<Password Type="{_SECURITY}username-token-profile-1.0#PasswordDigest">'
            f"{base64.b64encode(digest).decode()}</Password>"
            f'<Nonce EncodingType="{_SECURITY}soap-message-security-1.0#Base64Binary">'
            f"{base64.b64encode(nonce).decode()}</Nonce>"
            f'<Created xmlns="{_SECURITY}wssecurity-utility-1.0.xsd">{creation}'
            "</Created></UsernameToken></Security>"
        )


def _envelope(body: str, header: str = "") -> bytes:
    """Return a SOAP message."""
    return (
        '<?xml version="1.0" encoding="UTF-8"?>'
        '<s:Envelope xmlns:s="http://www.w3.org/2003/05/soap-envelope">'
        f"<s:Header>{header}</s:Header><s:Body>{body}</s:Body></s:Envelope>"
    ).encode()


def _shut(link: socket.socket) -> None:
    """End a read that waits."""
    with contextlib.suppress(OSError):
        link.shutdown(socket.SHUT_RDWR)


def _addresses(host: str) -> set[str]:
    """Return a host's name and its addresses, as far as they are known."""
    addresses = {host}
    with contextlib.suppress(OSError, UnicodeError):
        addresses |= {str(entry[4][0]) for entry in socket.getaddrinfo(host, None)}
    return addresses


def _is_this_machine(host: str) -> bool:
    """Return True for an address that means another machine to everybody, such as 0.0.0.0."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host.lower() == "localhost"
    return address.is_unspecified or address.is_loopback
