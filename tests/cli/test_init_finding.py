"""`camtopod init` finds cameras and their streams: by ONVIF, by maker."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from onvif_camera import USER, OnvifCamera, onvif_camera

from camtopod.cli import exits
from camtopod.cli.cameras import onvif, probe as probes
from camtopod.cli.cameras.finding import streams_by_onvif, streams_by_path
from camtopod.cli.main import main
from camtopod.codec import Rejected
from camtopod.untrusted_xml import DOCUMENT_BYTES_MAX, parse_xml
from camtopod.vision.source import percent_encoded
from camtopod.vision.source.makers import PATHS, streams_by_maker
from camtopod.vision.source.probe import Probe

PROFILES = [("main", 2560, 1440, 25), ("mid", 1280, 720, 15), ("sub", 640, 360, 10)]
STREAMS = {
    "main": "rtsp://127.0.0.1/1",
    "mid": "rtsp://127.0.0.1/2",
    "sub": "rtsp://127.0.0.1/3?a=1",
    "slow": "rtsp://127.0.0.1/4",
}
LOGIN = f"{USER}:p%40ss%2Fw%20ord"
"""User and password as they stand in a URL."""


@pytest.fixture
def camera() -> Iterator[OnvifCamera]:
    with onvif_camera([*PROFILES, ("slow", 640, 480, 2)], STREAMS) as one:
        yield one


# --- ONVIF ----------------------------------------------------------------------------------------


def test_the_smallest_stream_that_is_big_enough_is_taken(camera: OnvifCamera) -> None:
    source = f"onvif://{LOGIN}@{camera.address}"
    given = {"a": source, "b": "rtsp://192.0.2.1/x", "c": "onvif://127.0.0.1:1"}

    found, missing = streams_by_onvif(given)

    assert found == {"a": f"rtsp://{LOGIN}@127.0.0.1/3?a=1", "b": "rtsp://192.0.2.1/x"}
    assert percent_encoded(found["a"]) == found["a"]
    assert missing.keys() == {"c"}
    assert "no answer by ONVIF at http://127.0.0.1:1/" in missing["c"]
    assert camera.asked[0] == "/onvif/device_service GetSystemDateAndTime"
    assert camera.asked[2] == "/onvif/media GetProfiles", "at the host that was given"


def test_what_is_wrong_with_a_camera_is_said(camera: OnvifCamera) -> None:
    for login in ("viewer:wrong@", "other:x@", ""):
        with pytest.raises(onvif.OnvifError, match="refuses the user name or password"):
            onvif.streams(f"onvif://{login}{camera.address}")
    with pytest.raises(onvif.OnvifError, match="write it like"):
        onvif.streams("onvif://[:1")
    with onvif_camera([], {}) as blind, pytest.raises(onvif.OnvifError, match="offers no video"):
        onvif.streams(f"onvif://{LOGIN}@{blind.address}")


def test_documents_that_could_do_harm_are_refused() -> None:
    long = b"x" * (DOCUMENT_BYTES_MAX + 1)
    for document in (b"<!DOCTYPE x [<!ENTITY a 'b'>]><x>&a;</x>", b"<x>", b"", long):
        with pytest.raises(Rejected):
            parse_xml(document)


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
