"""A camera that speaks as much ONVIF as `camtopod init` asks for.

Its messages are rebuilt from the schemas of ONVIF's device and media services.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import re
import secrets
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

USER, PASSWORD = "viewer", "p@ss/w ord"
CLOCK = "2020-02-03T04:05:"
"""Beginning of the time that the camera's clock shows: it is years behind."""
_ENVELOPE = (
    '<?xml version="1.0" encoding="UTF-8"?><e:Envelope'
    ' xmlns:e="http://www.w3.org/2003/05/soap-envelope"'
    ' xmlns:tds="http://www.onvif.org/ver10/device/wsdl"'
    ' xmlns:trt="http://www.onvif.org/ver10/media/wsdl"'
    ' xmlns:tt="http://www.onvif.org/ver10/schema"><e:Body>{}</e:Body></e:Envelope>'
)
_TIME = (
    "<tds:GetSystemDateAndTimeResponse><tds:SystemDateAndTime><tt:UTCDateTime>"
    "<tt:Time><tt:Hour>4</tt:Hour><tt:Minute>5</tt:Minute><tt:Second>6</tt:Second></tt:Time>"
    "<tt:Date><tt:Year>2020</tt:Year><tt:Month>2</tt:Month><tt:Day>3</tt:Day></tt:Date>"
    "</tt:UTCDateTime></tds:SystemDateAndTime></tds:GetSystemDateAndTimeResponse>"
)
_CAPABILITIES = (
    "<tds:GetCapabilitiesResponse><tds:Capabilities><tt:Media>"
    "<tt:XAddr>http://10.0.0.9/onvif/media</tt:XAddr>"
    "</tt:Media></tds:Capabilities></tds:GetCapabilitiesResponse>"
)
_PROFILE = (
    '<trt:Profiles token="{}"><tt:AudioSourceConfiguration><tt:SourceToken>ear</tt:SourceToken>'
    "</tt:AudioSourceConfiguration>{}<tt:VideoEncoderConfiguration><tt:Resolution>"
    "<tt:Width>{}</tt:Width>"
    "<tt:Height>{}</tt:Height></tt:Resolution><tt:RateControl><tt:FrameRateLimit>{}"
    "</tt:FrameRateLimit></tt:RateControl></tt:VideoEncoderConfiguration></trt:Profiles>"
)
_SOUND = '<trt:Profiles token="sound"/>'
_URI = (
    "<trt:GetStreamUriResponse><trt:MediaUri><tt:Uri>{}</tt:Uri></trt:MediaUri>"
    "</trt:GetStreamUriResponse>"
)
_FAULT = (
    "<e:Fault><e:Code><e:Value>e:Sender</e:Value><e:Subcode><e:Value>ter:NotAuthorized</e:Value>"
    "</e:Subcode></e:Code></e:Fault>"
)


class OnvifCamera:
    """A camera at a free port of this machine.

    profiles: token, width, height and frame rate of each.
    streams: RTSP URL by token; of others it says that it has none.
    is_open: it wants no login.
    video_sources: description of the video source by token of a profile.
    challenges: headers WWW-Authenticate, with NONCE for the nonce; none: it takes username tokens.
    nonce_uses: how often a nonce is good.
    clock: status and body of the answer when it is asked for its time.
    """

    def __init__(
        self,
        profiles: list[tuple[str, int, int, int]],
        streams: dict[str, str],
        challenges: tuple[str, ...] = (),
        nonce_uses: int = 1000,
        clock: tuple[int, str] = (200, _TIME),
        video_sources: dict[str, str] | None = None,
        is_open: bool = False,
    ) -> None:
        self.is_open = is_open
        self.video_sources = video_sources or {}
        self.profiles, self.streams = profiles, streams
        self.challenges, self.nonce_uses, self.clock = challenges, nonce_uses, clock
        self.nonce, self.used = secrets.token_hex(8), 0
        self.time = CLOCK[:-3]
        self.asked: list[str] = []
        self.logins: list[str] = []
        camera = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["content-length"])).decode()
                authorization = self.headers["authorization"] or ""
                status, answer = camera.answer(self.path, body, authorization)
                self.send_response(status)
                for challenge in camera.challenges if status == 401 else ():
                    self.send_header("WWW-Authenticate", challenge.replace("NONCE", camera.nonce))
                self.end_headers()
                self.wfile.write(_ENVELOPE.format(answer).encode())

            def log_message(self, *_: Any) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"127.0.0.1:{self.server.server_port}"

    def answer(self, path: str, body: str, authorization: str) -> tuple[int, str]:
        """Return status and body of the answer to a request."""
        [asked] = re.findall(r"<s:Body><(\w+)", body)
        self.asked.append(f"{path} {asked}")
        if asked == "GetSystemDateAndTime":
            return self.clock
        if authorization or "<Username>" in body:
            self.logins.append(authorization.partition(" ")[0] or "token")
        if not self.is_open and self.challenges and not self._has_digest(path, authorization):
            return 401, ""
        if not self.is_open and not self.challenges and not self._is_allowed(body):
            return 400, _FAULT
        if asked == "GetCapabilities":
            return 200, _CAPABILITIES
        if asked == "GetProfiles":
            rows = "".join(
                _PROFILE.format(token, self.video_sources.get(token, ""), *figures)
                for token, *figures in self.profiles
            )
            return 200, f"<trt:GetProfilesResponse>{_SOUND}{rows}</trt:GetProfilesResponse>"
        [token] = re.findall(r"<ProfileToken>(.*?)</ProfileToken>", body)
        if token not in self.streams:
            return 500, "<e:Fault/>"
        return 200, _URI.format(self.streams[token])

    def _is_allowed(self, body: str) -> bool:
        """Return True if the user's token is right, and of the camera's present."""
        found = re.search(
            r"<Username>(.*?)</Username><Password[^>]*>(.*?)</Password>"
            r"<Nonce[^>]*>(.*?)</Nonce><Created[^>]*>(.*?)</Created>",
            body,
        )
        if found is None or PASSWORD in body:
            return False
        user, digest, nonce, created = found.groups()
        whole = base64.b64decode(nonce) + created.encode() + PASSWORD.encode()
        right = base64.b64encode(hashlib.sha1(whole).digest()).decode()
        return user == USER and digest == right and created.startswith(self.time)

    def _has_digest(self, path: str, authorization: str) -> bool:
        """Return True if the user's digest is right, and its nonce present."""
        fields = {
            name: quoted or plain
            for name, quoted, plain in re.findall(
                r'(\w+)=(?:"((?:[^"\\]|\\.)*)"|([^ ,]+))', authorization
            )
        }
        if not authorization.startswith("Digest ") or fields["nonce"] != self.nonce:
            return False
        self.used += 1
        if self.used > self.nonce_uses:
            self.nonce, self.used = secrets.token_hex(8), 0
            return False

        def digest(text: str) -> str:
            kind = "sha256" if fields.get("algorithm", "MD5").startswith("SHA-256") else "md5"
            return hashlib.new(kind, text.encode()).hexdigest()

        secret = digest(f"{USER}:{fields['realm']}:{PASSWORD}")
        if fields.get("algorithm", "").endswith("-sess"):
            secret = digest(f"{secret}:{self.nonce}:{fields['cnonce']}")
        middle = ""
        if "qop" in fields:
            assert int(fields["nc"], 16) == self.used, "each number is used once"
            middle = f"{fields['nc']}:{fields['cnonce']}:{fields['qop']}:"
        right = digest(f"{secret}:{self.nonce}:{middle}{digest(f'POST:{path}')}")
        return (fields["username"], fields["uri"], fields["response"]) == (USER, path, right)


@contextlib.contextmanager
def onvif_camera(*arguments: Any, **options: Any) -> Iterator[OnvifCamera]:
    """Serve an `OnvifCamera` while the block runs."""
    camera = OnvifCamera(*arguments, **options)
    thread = threading.Thread(target=camera.server.serve_forever, daemon=True)
    thread.start()
    try:
        yield camera
    finally:
        camera.server.shutdown()
        camera.server.server_close()
