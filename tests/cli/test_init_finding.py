"""`camtopod init` finds cameras and their streams: by ONVIF, by maker."""

from __future__ import annotations

import re
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from onvif_camera import USER, OnvifCamera, onvif_camera

from bench.support.rtsp_streams import Host, silent
from camtopod import redact
from camtopod.cli import exits
from camtopod.cli.cameras import onvif, probe as probes
from camtopod.cli.cameras.finding import streams_as_named, streams_by_onvif, streams_by_path
from camtopod.cli.main import main
from camtopod.codec import Rejected
from camtopod.config import CameraSettings
from camtopod.untrusted_xml import DOCUMENT_BYTES_MAX, parse_xml
from camtopod.vision.source import percent_encoded
from camtopod.vision.source.probe import Probe
from camtopod.vision.source.source_url import PATHS, streams_by_maker

PROFILES = [("main", 2560, 1440, 25), ("mid", 1280, 720, 15), ("sub", 640, 360, 10)]
STREAMS = {
    "main": "rtsp://127.0.0.1/1",
    "mid": "rtsp://127.0.0.1/2",
    "sub": "rtsp://127.0.0.1/3?a=1",
    "slow": "rtsp://127.0.0.1/4",
}
LOGIN = f"{USER}:p%40ss%2Fw%20ord"
"""User and password as they stand in a URL."""


@pytest.fixture(autouse=True)
def _forget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(redact, "_secrets", set())


@pytest.fixture
def camera() -> Iterator[OnvifCamera]:
    with onvif_camera([*PROFILES, ("slow", 640, 480, 2)], STREAMS) as one:
        yield one


# --- ONVIF ----------------------------------------------------------------------------------------


def test_the_smallest_stream_that_is_big_enough_is_taken(camera: OnvifCamera) -> None:
    source = f"onvif://{LOGIN}@{camera.address}"
    given = {"a": source, "b": "rtsp://192.0.2.1/x", "c": "onvif://127.0.0.1:1"}

    found = streams_by_onvif(given)

    assert found.urls == {"a": f"rtsp://{LOGIN}@127.0.0.1/3?a=1", "b": "rtsp://192.0.2.1/x"}
    assert percent_encoded(found.urls["a"]) == found.urls["a"]
    assert found.remarks == {}
    assert found.reasons.keys() == {"c"}
    assert "no answer by ONVIF at http://127.0.0.1:1/" in found.reasons["c"]
    assert camera.asked[0] == "/onvif/device_service GetSystemDateAndTime"
    assert camera.asked[2] == "/onvif/media GetProfiles", "at the host that was given"


def test_what_is_wrong_with_a_camera_is_said(camera: OnvifCamera) -> None:
    for login in ("viewer:wrong@", "other:x@"):
        with pytest.raises(onvif.OnvifError, match="refuses the user name or password"):
            onvif.streams(f"onvif://{login}{camera.address}")
    with pytest.raises(onvif.OnvifError, match="asks for a login: write onvif://USER:PASS"):
        onvif.streams(f"onvif://{camera.address}")
    with pytest.raises(onvif.OnvifError, match="write it like"):
        onvif.streams("onvif://[:1")
    with onvif_camera([], {}) as blind, pytest.raises(onvif.OnvifError, match="offers no video"):
        onvif.streams(f"onvif://{LOGIN}@{blind.address}")


@pytest.mark.parametrize(
    "url",
    [
        "rtsp://192.0.2.66/s",
        "rtsp://192.0.2.66:554/127.0.0.1",
        "rtsp://0.0.0.0:8554/a?b=1",
        "rtsp://[::]:554/x",
        "rtsp://camera.invalid",
    ],
)
def test_a_password_goes_to_the_host_that_was_given_alone(url: str) -> None:
    """Another host is that of the camera behind a router, or none at all."""
    with onvif_camera([PROFILES[0]], {"main": url}) as camera:
        found = streams_by_onvif({"a": f"onvif://{LOGIN}@{camera.address}"})
    port_and_path = re.sub(r"rtsp://(\[.*?\]|[^:/]*)", "", url)
    assert found.urls == {"a": f"rtsp://{LOGIN}@127.0.0.1{port_and_path}"}
    [remark] = found.remarks["a"]
    assert f"names a stream at another host, {url}; the host that answered is tried" in remark
    assert (found.reasons, found.other_urls) == ({}, {})


@pytest.mark.parametrize(
    "url", ["x", "", "rtsp://", "rtsp:///s", "rtsp://[a/s", "file:///etc/hosts"]
)
@pytest.mark.parametrize("login", [f"{LOGIN}@", ""])
def test_what_is_no_url_is_shown(url: str, login: str) -> None:
    with onvif_camera([PROFILES[0]], {"main": url}, is_open=not login) as camera:
        found = streams_by_onvif({"a": f"onvif://{login}{camera.address}"})
    assert found.urls == {}
    said = f"names no URL of a stream, but '{url}': give the stream's rtsp:// URL"
    assert said in found.reasons["a"]


def test_a_password_that_a_camera_repeats_is_not_shown() -> None:
    with onvif_camera([PROFILES[0]], {"main": "rtsp://192.0.2.66/p@ss/w ord/x"}) as camera:
        found = streams_by_onvif({"a": f"onvif://{LOGIN}@{camera.address}"})
    assert "at another host, rtsp://192.0.2.66/***/x; the host" in found.remarks["a"][0]


def test_a_stream_without_a_password_may_be_at_another_host() -> None:
    streams = {
        "main": "rtsp://192.0.2.66/s",
        "mid": "rtsp://me:secret@192.0.2.66/s",
        "sub": "rtsp://0.0.0.0/s",
    }
    sources = {token: lens(token) for token in streams}
    with onvif_camera(PROFILES, streams, video_sources=sources, is_open=True) as camera:
        found = streams_by_onvif({"a": f"onvif://{camera.address}"})
    assert found.urls == {
        "a": "rtsp://127.0.0.1/s",
        "a-2": "rtsp://me:secret@127.0.0.1/s",
        "a-3": "rtsp://127.0.0.1/s",
    }
    assert found.other_urls == {"a": streams["main"], "a-2": streams["mid"]}
    assert "another host, rtsp://***@192.0.2.66/s; the" in found.remarks["a-2"][1]

    bad, works = Probe("nothing listens"), Probe("", "H.264", 640, 360, 10.0)
    seen = {"a": bad, "a-2": works, "a-3": bad}
    tried: dict[str, str] = {}

    def look(urls: Mapping[str, str]) -> Mapping[str, Probe]:
        tried.update(urls)
        return dict.fromkeys(urls, works)

    assert streams_as_named(found.other_urls, seen, look) == {"a": (streams["main"], works)}
    assert tried.keys() == {"a"}


def test_a_stream_cannot_hide_another_host_in_its_path() -> None:
    with onvif_camera([PROFILES[0]], {"main": "rtsp://localhost/a@192.0.2.66/b"}) as camera:
        found = streams_by_onvif({"a": f"onvif://{LOGIN}@{camera.address}"})
    assert urlsplit(percent_encoded(found.urls["a"])).hostname == "localhost", "this machine's name"


def lens(token: str, crop: str = "whole") -> str:
    """Describe a video source as a profile does."""
    text = f"<tt:SourceToken>{token}</tt:SourceToken>" if token else ""
    return f'<tt:VideoSourceConfiguration token="{crop}">{text}</tt:VideoSourceConfiguration>'


def test_each_lens_becomes_a_camera() -> None:
    profiles = [("wide", 2560, 1440, 25), ("tele", 1920, 1080, 25), ("tele2", 640, 360, 12)]
    profiles += [("door", 640, 480, 10), ("wide2", 640, 360, 15), ("empty", 640, 360, 15)]
    sources = {
        "wide": lens("1", "a"),
        "wide2": lens("1", "b"),
        "tele": lens("2"),
        "tele2": lens("2"),
    }
    sources |= {"door": lens("", "c"), "empty": lens("", "d")}
    streams = {name: f"rtsp://127.0.0.1/{name}" for name, *_ in profiles[:-1]}
    long = "x" * 64
    with onvif_camera(profiles, streams, video_sources=sources) as camera:
        source = f"onvif://{LOGIN}@{camera.address}"
        given = {"hall": source, "hall-3": "rtsp://192.0.2.1/x", long: source}
        found = streams_by_onvif(given, ["hall-2"])

    begin = f"rtsp://{LOGIN}@127.0.0.1"
    assert [*found.urls.items()] == [
        ("hall", f"{begin}/wide2"),
        ("hall-4", f"{begin}/tele2"),
        ("hall-5", f"{begin}/door"),
        ("hall-3", "rtsp://192.0.2.1/x"),
        (long, f"{begin}/wide2"),
        (f"{long[:59]}-2", f"{begin}/tele2"),
        (f"{long[:59]}-3", f"{begin}/door"),
    ]
    assert found.reasons.keys() == {"hall-6", f"{long[:59]}-4"}, "the channel without a stream"
    assert "status 500" in found.reasons["hall-6"]
    assert found.remarks["hall-4"] == ["video source 2 of 4 of hall: a lens or a channel"]


def drip(client: socket.socket) -> None:
    """Answer a byte at a time, without end."""
    client.recv(65536)
    client.sendall(b"HTTP/1.1 200 OK\r\n")
    while True:
        client.sendall(b"a")
        time.sleep(0.02)


def drip_content(client: socket.socket) -> None:
    client.recv(65536)
    client.sendall(b"HTTP/1.1 200 OK\r\n\r\n")
    drip(client)


@pytest.mark.parametrize("treat", [silent, drip, drip_content])
def test_a_camera_that_answers_without_end_is_given_up(
    treat: Callable[[socket.socket], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(onvif, "SECONDS", 0.2)
    host = Host(treat)
    address = host.url.partition("@")[2].partition("/")[0]
    with pytest.raises(onvif.OnvifError, match=r"no answer by ONVIF .* within 0 s|timed out"):
        onvif.streams(f"onvif://{address}")
    host.close()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-16-le", "utf-16-be", "utf-32"])
def test_documents_that_could_do_harm_are_refused(encoding: str) -> None:
    bomb = "<?xml version='1.0'?><!DOCTYPE x [<!ENTITY a 'b'>]><x>&a;</x>"
    long = "x" * (DOCUMENT_BYTES_MAX + 1)
    for document in (bomb, bomb.replace("?>", f" encoding='{encoding}'?>"), "<x>", "", long):
        with pytest.raises(Rejected):
            parse_xml(document.encode(encoding))


# --- paths of makers ------------------------------------------------------------------------------


@pytest.mark.parametrize("host", ["192.0.2.1", "u:p@192.0.2.1:8554", "u:p/w@d@cam.lan"])
def test_a_url_without_a_path_has_one_guess_for_each_maker(host: str) -> None:
    for end in ("", "/"):
        found = streams_by_maker(f"rtsp://{host}{end}")
        assert found == {maker: f"rtsp://{host}{path}" for maker, path in PATHS.items()}


def test_the_path_that_opens_is_taken_where_the_camera_has_no_such_stream() -> None:
    sources = {name: f"rtsp://{name}" for name in ("found", "locked", "away", "none", "good")}
    sources["path"] = "rtsp://path/x"
    missing = Probe("cannot be opened: the camera has no such stream (404)")
    seen = dict.fromkeys(sources, missing) | {
        "locked": Probe("cannot be opened: the camera refuses the user name or password (401)"),
        "away": Probe("cannot be opened: nothing listens at this address and port"),
        "good": Probe("", "H.264", 640, 480, 10.0),
    }
    works = Probe("", "H.264", 1920, 1080, 25.0)
    tried: set[str] = set()

    def look(urls: Mapping[str, str]) -> dict[str, Probe]:
        tried.update(urls.values())
        return {
            name: works if url == "rtsp://found/Streaming/Channels/101" else missing
            for name, url in urls.items()
        }

    found = streams_by_path(sources, seen, look)
    assert found == {"found": ("rtsp://found/Streaming/Channels/101", "Hikvision, Annke", works)}
    assert {url.split("/")[2] for url in tried} == {"found", "none"}, "nobody is locked out"


# --- the command ----------------------------------------------------------------------------------


def test_a_camera_that_refuses_is_left_out(
    camera: OnvifCamera,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(probes, "_probe", lambda *_: Probe("", "H.264", 640, 360, 10.0))
    out = tmp_path / "camtopod.toml"
    given = [f"bad=onvif://viewer:wrong@{camera.address}", "good=rtsp://127.0.0.1/9"]
    assert main(["init", *given, "--out", str(out)]) == exits.INPUT
    assert "bad  left out: the camera refuses the user name" in capsys.readouterr().err
    assert "[cameras.good]" in out.read_text()
    assert "[cameras.bad]" not in out.read_text()


@pytest.mark.parametrize("opens", ["127.0.0.1", "192.0.2.66", "nowhere"])
def test_the_url_at_another_host_is_shown_and_written(
    opens: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def probe(settings: CameraSettings, _: bool) -> Probe:
        if f"//{opens}/" in settings.source:
            return Probe("", "H.264", 640, 360, 10.0)
        return Probe("cannot be opened: nothing listens")

    monkeypatch.setattr(probes, "_probe", probe)
    out = tmp_path / "camtopod.toml"
    url = "rtsp://192.0.2.66/live"
    with onvif_camera([PROFILES[0]], {"main": url}, is_open=True) as camera:
        status = main(["init", f"a=onvif://{camera.address}", "--out", str(out)])
    assert status == (exits.INPUT if opens == "nowhere" else exits.DONE)
    text, said = out.read_text(), capsys.readouterr().err
    remark = f"names a stream at another host, {url}; the host that answered is tried in its place"
    for place in (text, said):
        assert remark in place
    host = "192.0.2.66" if opens == "192.0.2.66" else "127.0.0.1"
    assert f'source = "rtsp://{host}/live"' in text
    assert ("found at the host that it names" in said) is (opens == "192.0.2.66")


def test_both_lenses_are_written_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(probes, "_probe", lambda *_: Probe("", "H.264", 640, 360, 10.0))
    out = tmp_path / "camtopod.toml"
    out.write_text("[cameras.gate-2]\nsource = '0'\n")
    sources = {"main": lens("1"), "mid": lens("2")}
    with onvif_camera(PROFILES[:2], STREAMS, video_sources=sources) as camera:
        source = f"gate=onvif://{LOGIN}@{camera.address}"
        assert main(["init", source, "--out", str(out)]) == exits.DONE
    said = capsys.readouterr().err
    for camera_id, place, path in (("gate", "1 of 2", "1"), ("gate-3", "2 of 2", "2")):
        assert f"  {camera_id}  H.264, 640x360, 10 frames a second; video source {place}" in said
        assert f"[cameras.{camera_id}]\n# H.264" in out.read_text()
        secret = (tmp_path / "secrets" / camera_id).read_text()
        assert secret == f"rtsp://{LOGIN}@127.0.0.1/{path}\n"
    assert "camtopod.toml has gate, gate-3\n" in said
