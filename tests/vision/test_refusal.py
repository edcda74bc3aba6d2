"""What is said of a source that cannot be opened: always a reason, and what helps."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from bench.support.rtsp_streams import Host, silent
from camtopod.vision.settings import VisionSettings
from camtopod.vision.source import captured_log, kind_of, percent_encoded
from camtopod.vision.source.ffmpeg_log import NO_LOG, FfmpegLog
from camtopod.vision.source.probe import ProbeRequest, probe
from camtopod.vision.source.refusal import why_not_opened

SOUND = "v=0\r\ns=door\r\nm=audio 0 RTP/AVP 8\r\na=control:a\r\n"
PAGE = "HTTP/1.1 200 OK\r\nContent-Type: text/html\r\n\r\n<html></html>"


def rtsp(status: str, *headers: str, body: str = "") -> str:
    """Return an answer by RTSP."""
    lines = [f"RTSP/1.0 {status}", "CSeq: 1", *headers, f"Content-Length: {len(body)}", "", body]
    return "\r\n".join(lines)


def answering(answer: str) -> Callable[[socket.socket], None]:
    """Answer each question in the same way."""

    def treat(client: socket.socket) -> None:
        client.recv(65536)
        client.sendall(answer.encode())

    return treat


def said_of(scheme: str, treat: Callable[[socket.socket], None], log: FfmpegLog = NO_LOG) -> str:
    """Return what is said of a stream at a host that treats connections like this."""
    host = Host(treat)
    reason = why_not_opened(host.url.replace("rtsp:", f"{scheme}:"), log)
    host.close()
    assert "ssw0rd" not in reason
    return reason


@pytest.mark.parametrize(
    ("scheme", "answer", "said"),
    [
        ("rtsps", "\x15\x03\x01\0\x02\x02\x46", "nothing comes from there"),  # a TLS alert: version
        ("rtsps", "\x15\x03\x03\0\x02\x02\x28", "nothing comes from there"),  # handshake failure
        ("rtsp", rtsp("200 OK", body=SOUND), "there is no video in it"),
        ("RTSP", rtsp("200 OK", body=SOUND), "there is no video in it"),
        ("rtsp", PAGE, "it speaks HTTP at this port: write http://"),
        ("http", PAGE, "it is a web page, no video"),
        ("http", rtsp("400 Bad Request"), "it speaks RTSP at this port: write rtsp://"),
        ("rtsps", rtsp("200 OK"), "it has no TLS at this port: write rtsp://"),
        ("https", PAGE, "it has no TLS at this port: write http://"),
        ("rtsp", rtsp("200 OK", body=SOUND.replace("audio", "video")), "nothing comes from there"),
        ("rtsp", "", "nothing comes from there"),
        ("http", "\0\r\n\r\n\xff", "nothing comes from there"),
    ],
)
def test_the_host_s_own_answer_tells_why(scheme: str, answer: str, said: str) -> None:
    assert said_of(scheme, answering(answer)).startswith(said)


@pytest.mark.parametrize(
    ("challenges", "said"),
    [
        (['Digest realm="x", nonce="y", algorithm=SHA-256'], "the camera wants SHA-256 digests"),
        (['digest nonce="y", algorithm="sha-512-256"'], "the camera wants SHA-512-256 digests"),
        (['Digest nonce="y"', 'Digest nonce="y", algorithm=SHA-256'], "the camera wants SHA-256"),
        (['Digest nonce="y", algorithm=SHA-256', "Basic realm=x"], "the camera wants SHA-256"),
        (["NTLM", "Negotiate"], "the camera wants NTLM or Negotiate as login"),
        (['Digest nonce="y", algorithm=SHA-256', 'Digest nonce="y", algorithm=MD5'], None),
        (['Digest realm="x", nonce="y", qop="auth,auth-int"'], None),
        (["NTLM", 'Basic realm="x"'], None),
        ([], None),
    ],
)
@pytest.mark.parametrize("scheme", ["rtsp", "http"])
def test_a_login_that_ffmpeg_does_not_know_is_no_wrong_password(
    scheme: str, challenges: list[str], said: str | None
) -> None:
    answer = rtsp("401 Unauthorized", *(f"WWW-Authenticate: {text}" for text in challenges))
    answer = answer.replace("RTSP/1.0", f"{scheme.upper()}/1.0")
    with captured_log() as log:
        os.write(1, b"[rtsp] method DESCRIBE failed: 401 Unauthorized\n")
        reason = said_of(scheme, answering(answer), log)
    if said is None:
        assert reason == "the camera refuses the user name or password (401)"
    else:
        assert reason.startswith(said)
        assert reason.endswith("set the camera's authentication to MD5 (digest) alone")


def test_a_host_that_says_nothing_is_not_waited_for_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("camtopod.vision.source.refusal.ASK_SECONDS", 0.2)
    assert said_of("http", silent).startswith("nothing comes from there")

    trickle = threading.Event()

    def trickling(client: socket.socket) -> None:
        while not trickle.wait(0.05):
            client.sendall(b"x")

    assert said_of("rtsp", trickling).startswith("nothing comes from there")
    trickle.set()


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("srt://192.0.2.1:9000", "this program's FFmpeg has no SRT"),
        ("rtp://192.0.2.1:5004", "write that to a file camera.sdp"),
        ("udp://:5004", "no MPEG-TS comes from there"),
        ("rtmp://192.0.2.1/live", "no video comes from there by RTMP"),
        ("rtsp://", "it names no host"),
        ("rtsp://192.0.2.1:70000/s", "the port is a number below 65536"),
        ("rstp://192.0.2.1/s", "rstp:// is none of rtsp, rtsps, "),
    ],
)
def test_a_url_from_which_nothing_comes_has_a_reason(source: str, said: str) -> None:
    assert said in why_not_opened(source, NO_LOG)


def test_a_proxy_is_named_unless_the_camera_is_excepted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", "http://u:secret@192.0.2.9:3128")
    reason = said_of("http", answering(PAGE))
    assert reason.endswith("a proxy is used (http_proxy): write the camera's host into no_proxy")
    assert "secret" not in reason
    monkeypatch.setenv("no_proxy", "camera.example,127.0.0.1")
    assert "proxy" not in said_of("http", answering(PAGE))


def test_urls_are_read_as_people_write_them() -> None:
    for source in (" RTSP://u:p@192.0.2.1/S ", "Rtsp://u:p@192.0.2.1/S\n"):
        assert kind_of(source) == "stream"
        assert percent_encoded(source) == "rtsp://u:p@192.0.2.1/S"


def test_a_date_is_no_number_of_a_device() -> None:
    assert kind_of("12") == "device"
    assert kind_of("20260101120000") == "file"
    problem = probe(ProbeRequest("20260101120000", VisionSettings()), NO_LOG).problem
    assert problem == "No such file or directory"


def test_a_stream_that_a_file_describes_is_live(tmp_path: Path) -> None:
    path = tmp_path / "hall 1.SDP"
    assert kind_of(str(path)) == kind_of(f"file://{path}") == "stream"
    assert why_not_opened(str(path), NO_LOG) == "No such file or directory"
    path.write_text(SOUND)
    assert "a line m=video" in why_not_opened(str(path), NO_LOG)
    path.write_text(SOUND.replace("audio", "video"))
    assert "no RTP comes as the SDP file says" in why_not_opened(str(path), NO_LOG)


@pytest.mark.parametrize(
    ("name", "said"),
    [(".", "a directory cannot be read"), ("img_%04d.jpg", "a picture sequence cannot be read")],
)
def test_pictures_are_to_be_made_a_video(name: str, said: str, tmp_path: Path) -> None:
    with captured_log() as log:
        problem = probe(ProbeRequest(str(tmp_path / name), VisionSettings()), log).problem
    assert problem.startswith(said)
    assert "ffmpeg -framerate 25" in problem
