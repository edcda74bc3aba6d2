"""Why a device or stream cannot be opened.

FFmpeg's log has most reasons. Where it has none, or only what the host replied, the host is asked
once without FFmpeg, and without a login: it may speak another protocol, have no video, or want a
kind of login that FFmpeg does not know, which it never sent.
"""

from __future__ import annotations

import os
import re
import socket
import ssl
import time
from urllib.parse import SplitResult, urlsplit

from camtopod.vision.source.ffmpeg_log import UNREACHED, FfmpegLog
from camtopod.vision.source.source_url import (
    device_number,
    file_path,
    is_path,
    percent_encoded,
    scheme_of,
)

ASK_SECONDS = 2.0
"""Longest time for each question to a host."""
ANSWER_BYTES_MAX = 1 << 16
"""Length of an answer that is read at most."""
_SCHEMES = ("rtsp", "rtsps", "rtmp", "rtmps", "http", "https", "tcp", "udp", "rtp")
"""Schemes of streams that FFmpeg reads, however it was built."""
_OTHERS = {
    "onvif": "`camtopod init` asks a camera for its streams by ONVIF: give what it finds",
    "v4l2": "give a device by its number, or as /dev/video0",
}
"""Advice on URLs that are no streams, by scheme."""
_RTMP = "no video comes from there by RTMP: check the address and the stream's name"
_MPEG_TS = "no MPEG-TS comes from there: check the sender, the address and the port"
_SILENCE = {
    "srt": "this program's FFmpeg has no SRT, or nothing answers: let a media server turn it into "
    "RTSP",
    "rtp": "no MPEG-TS comes from there; other video by RTP needs its description: write that to a "
    "file camera.sdp, and give its path",
    **dict.fromkeys(("tcp", "udp"), _MPEG_TS),
    **dict.fromkeys(("rtmp", "rtmps"), _RTMP),
}
"""What is said if nothing else is known, by scheme."""
_NO_VIDEO = "there is no video in it, sound alone perhaps: give the URL of a stream with video"
_PORTS = {"rtsp": 554, "rtsps": 322, "http": 80, "https": 443}
"""Usual ports of what can be asked."""
_STATUS = re.compile(r"(RTSP|HTTP)/\d\.\d (\d\d\d)")


def why_not_opened(source: str, ffmpeg_log: FfmpegLog) -> str:
    """Return why a device or stream could not be opened, and what helps; never "".

    Asks the host of a URL if need be, for at most a few times `ASK_SECONDS`.
    """
    number = device_number(source)
    if number is not None:
        return _why_no_device(number)
    if is_path(source):
        return _why_no_description(file_path(source))
    if reason := why_no_stream(source):
        return reason
    scheme = scheme_of(source)
    reason = ffmpeg_log.newest_reason()
    try:
        url = urlsplit(percent_encoded(source))
        if not url.hostname and scheme not in ("udp", "rtp"):
            return "it names no host: write rtsp://USER:PASSWORD@HOST:PORT/PATH, for example"
        port = url.port
    except ValueError:
        return "its host and port cannot be read: the port is a number below 65536"
    if scheme in _PORTS and reason not in UNREACHED:
        reason = _why_not_sent(url, port or _PORTS[scheme]) or reason
    if not reason:
        reason = _SILENCE.get(
            scheme,
            "nothing comes from there that this program's FFmpeg can read: check the URL in a "
            "player such as VLC",
        )
    if scheme.startswith("http") and _has_proxy(url.hostname or ""):
        reason += "; a proxy is used (http_proxy): write the camera's host into no_proxy"
    return reason


def why_no_stream(source: str) -> str:
    """Return why no URL with this scheme can be read; "" if it may, or if it is no URL."""
    scheme = scheme_of(source)
    if scheme in ("", "file", *_SCHEMES, *_SILENCE):
        return ""
    return _OTHERS.get(scheme, f"{scheme}:// is none of {', '.join(_SCHEMES)}")


def _why_no_device(number: int) -> str:
    """Return why a video device cannot be opened."""
    path = f"/dev/video{number}"
    if not os.path.exists(path):
        return f"{path} does not exist"
    if not os.access(path, os.R_OK | os.W_OK):
        return f"no permission for {path}: add this user to the group video"
    return f"{path} is in use or is not a camera"


def _why_no_description(path: str) -> str:
    """Return why the stream that an SDP file describes cannot be opened."""
    try:
        with open(path, "rb") as file:
            text = file.read(ANSWER_BYTES_MAX)
    except OSError as error:
        return error.strerror or str(error)
    if not re.search(rb"(?m)^m=video", text):
        return f"{_NO_VIDEO} (a line m=video in the SDP file)"
    return "no RTP comes as the SDP file says: check the sender, the address and the port"


def _has_proxy(host: str) -> bool:
    """Return whether FFmpeg asks a proxy for what it reads from ``host`` by HTTP."""
    exceptions = re.split(r"[ ,]+", os.environ.get("no_proxy", ""))
    return bool(os.environ.get("http_proxy")) and not any(
        name == "*" or host == name or (name and host.endswith(f".{name.lstrip('.')}"))
        for name in exceptions
    )


def _why_not_sent(url: SplitResult, port: int) -> str:
    """Return why a host does not send a stream, as far as its own answer shows; else ""."""
    has_tls = url.scheme in ("rtsps", "https")
    is_rtsp = url.scheme.startswith("rtsp")
    try:
        answer = _answer(url, port, is_rtsp)
        if not is_rtsp and not answer.startswith("HTTP/"):
            answer = _answer(url, port, is_rtsp=True)
    except ssl.SSLError as error:
        if re.search("ALERT|UNSUPPORTED_PROTOCOL", error.reason or ""):
            return ""  # it answers by TLS, but of an old version, or wants a certificate
        return f"it has no TLS at this port: write {url.scheme[:-1]}://, or give another port"
    match = _STATUS.match(answer)
    if match is None:
        return ""
    protocol, status = match.groups()
    if status == "401":
        return _unknown_login(answer)
    is_page = re.search(r"(?im)^content-type: *text/html", answer) is not None
    if is_rtsp and protocol == "HTTP":
        return "it speaks HTTP at this port: write http://, or give the port of RTSP, usually 554"
    if not is_rtsp and protocol == "RTSP":
        return f"it speaks RTSP at this port: write rtsp{'s' if has_tls else ''}://"
    if is_rtsp and status == "200" and "\nm=" in answer and "\nm=video" not in answer:
        return _NO_VIDEO
    if not is_rtsp and status == "200" and is_page:
        return "it is a web page, no video: give the URL of the stream itself"
    return ""


def _unknown_login(answer: str) -> str:
    """Return which kind of login an answer wants if FFmpeg does not know it; else ""."""
    # FFmpeg answers the last challenge for a digest, or else one for the plain password (Basic).
    challenges = re.findall(r"(?im)^www-authenticate: *(\w+) *(.*)$", answer)
    digests = [fields for kind, fields in challenges if kind.lower() == "digest"]
    kinds = [kind for kind, _ in challenges]
    if digests:
        algorithm = re.search(r'(?i)\balgorithm *= *"?([\w-]+)', digests[-1])
        name = algorithm[1].upper() if algorithm else "MD5"
        if name in ("MD5", "MD5-SESS"):
            return ""
        kinds = [f"{name} digests"]
    elif not kinds or "basic" in map(str.lower, kinds):
        return ""
    return (
        f"the camera wants {' or '.join(kinds)} as login (401), which this program's FFmpeg does "
        "not know: set the camera's authentication to MD5 (digest) alone"
    )


def _answer(url: SplitResult, port: int, is_rtsp: bool) -> str:
    """Return what a host answers to a question for the stream, without a login; "" if nothing.

    Raises `ssl.SSLError` if it should speak TLS, and does not.
    """
    host = url.netloc.rpartition("@")[2]
    target = (url.path or "/") + (f"?{url.query}" if url.query else "")
    tls = "s" if url.scheme in ("rtsps", "https") else ""
    request = f"GET {target} HTTP/1.0\r\nHost: {host}\r\n\r\n"
    if is_rtsp:
        request = f"DESCRIBE rtsp{tls}://{host}{target} RTSP/1.0\r\nCSeq: 1\r\n"
        request += "Accept: application/sdp\r\n\r\n"
    deadline = time.monotonic() + ASK_SECONDS
    answer = b""
    try:
        with socket.create_connection((url.hostname, port), ASK_SECONDS) as plain:
            connection = _over_tls(plain) if tls else plain
            with connection:
                connection.sendall(request.encode())
                while not _is_whole(answer) and time.monotonic() < deadline:
                    data = connection.recv(4096)
                    if not data:
                        break
                    answer += data
    except ssl.SSLError:
        raise
    except (OSError, UnicodeError):  # the latter of a name that is none
        pass
    return answer.decode("latin-1")


def _over_tls(plain: socket.socket) -> ssl.SSLSocket:
    """Return a connection over TLS, without checking the host: no secret is sent over it."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context.wrap_socket(plain)


def _is_whole(answer: bytes) -> bool:
    """Return whether an answer has come with its body, or is longer than what is of interest."""
    head, _, body = answer.partition(b"\r\n\r\n")
    length = re.search(rb"(?im)^content-length: *(\d{1,6})\r?$", head)
    body_bytes = int(length[1]) if length else 0
    return len(answer) >= ANSWER_BYTES_MAX or (len(head) < len(answer) and len(body) >= body_bytes)
