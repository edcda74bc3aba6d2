"""`camtopod init` finds cameras and their streams: by WS-Discovery, by ONVIF, by maker."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from onvif_camera import MATCH, PASSWORD, USER, OnvifCamera, answering_probes, onvif_camera

from camtopod.cli import exits
from camtopod.cli.cameras import discovery, onvif
from camtopod.cli.cameras import probe as probes
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


# --- WS-Discovery ---------------------------------------------------------------------------------


def test_cameras_that_answer_are_found_once() -> None:
    two = MATCH.format("http://[::1]/onvif/device_service http://127.0.0.1:8000/onvif/x")
    other = MATCH.format("http://192.0.2.7/onvif/device_service")
    bad = [b"no XML", b"<!DOCTYPE a><a/>", MATCH.format("ftp://192.0.2.8/ http://[").encode()]
    with answering_probes(*bad, two.encode(), two.encode(), other.encode()) as group:
        found = discovery.discover(1.0, group)
    assert [(one.host, one.service) for one in found] == [
        ("127.0.0.1", "http://127.0.0.1:8000/onvif/x"),
        ("192.0.2.7", "http://192.0.2.7/onvif/device_service"),
    ]
    assert found[0].name == "ACME Dome D-42"


def test_a_network_without_cameras_gives_none() -> None:
    with answering_probes() as group:
        assert discovery.discover(0.2, group) == []


# --- ONVIF ----------------------------------------------------------------------------------------


def test_a_camera_says_its_streams_to_who_knows_the_password(camera: OnvifCamera) -> None:
    found = onvif.streams(f"onvif://{LOGIN}@{camera.address}")
    figures = [(one.width, one.height, one.fps) for one in found[:3]]
    assert figures == [profile[1:] for profile in PROFILES]
    assert found[2].url == f"rtsp://{LOGIN}@127.0.0.1/3?a=1"
    assert percent_encoded(found[2].url) == found[2].url
    assert camera.asked[0] == "/onvif/device_service GetSystemDateAndTime"
    assert camera.asked[2] == "/onvif/media GetProfiles", "at the host that was given"


@pytest.mark.parametrize("login", ["viewer:wrong@", "other:x@", ""])
def test_a_wrong_password_is_said(camera: OnvifCamera, login: str) -> None:
    with pytest.raises(onvif.OnvifError, match="refuses the user name or password"):
        onvif.streams(f"onvif://{login}{camera.address}")


def test_what_is_no_camera_is_said() -> None:
    with pytest.raises(onvif.OnvifError, match=r"no answer by ONVIF at http://127\.0\.0\.1:1/"):
        onvif.streams("onvif://127.0.0.1:1")
    with pytest.raises(onvif.OnvifError, match="write it like"):
        onvif.streams("onvif://[:1")
    with (
        onvif_camera([], {}) as camera,
        pytest.raises(onvif.OnvifError, match="offers no video"),
    ):
        onvif.streams(f"onvif://{LOGIN}@{camera.address}")
    with (
        onvif_camera(PROFILES[:1], {"main": "http://127.0.0.1/film"}) as camera,
        pytest.raises(onvif.OnvifError, match="a stream that is not RTSP"),
    ):
        onvif.streams(f"onvif://{LOGIN}@{camera.address}")


def test_documents_that_could_do_harm_are_refused() -> None:
    for document in (
        b"<!DOCTYPE x [<!ENTITY a 'b'>]><x>&a;</x>",
        b"<x>",
        b"",
        b"x" * (DOCUMENT_BYTES_MAX + 1),
    ):
        with pytest.raises(Rejected):
            parse_xml(document)


def test_the_smallest_stream_that_is_big_enough_is_taken(camera: OnvifCamera) -> None:
    source = f"onvif://{LOGIN}@{camera.address}"
    given = {"a": source, "b": "rtsp://192.0.2.1/x", "c": "onvif://127.0.0.1:1"}
    found, missing = streams_by_onvif(given, largest=False)
    assert found == {"a": f"rtsp://{LOGIN}@127.0.0.1/3?a=1", "b": "rtsp://192.0.2.1/x"}
    assert missing.keys() == {"c"}
    found, _ = streams_by_onvif({"a": source}, largest=True)
    assert found == {"a": f"rtsp://{LOGIN}@127.0.0.1/1"}


# --- paths of makers ------------------------------------------------------------------------------


@pytest.mark.parametrize("host", ["192.0.2.1", "u:p@192.0.2.1:8554", "u:p/w@d@cam.lan"])
def test_a_url_without_a_path_has_one_guess_for_each_maker(host: str) -> None:
    for end in ("", "/"):
        found = streams_by_maker(f"rtsp://{host}{end}")
        assert found == {maker: f"rtsp://{host}{path}" for maker, path in PATHS.items()}


@pytest.mark.parametrize("source", ["rtsp://h/x", "rtsp://h?x", "film.mp4", "0", "http://h"])
def test_other_sources_have_none(source: str) -> None:
    assert streams_by_maker(source) == {}


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


@pytest.fixture
def network(monkeypatch: pytest.MonkeyPatch, camera: OnvifCamera) -> Iterator[OnvifCamera]:
    """A network with one camera, whose streams all open."""
    match = MATCH.format(f"http://{camera.address}/onvif/device_service").encode()
    monkeypatch.setattr(probes, "_probe", lambda *_: Probe("", "H.264", 640, 360, 10.0))
    with answering_probes(match) as group:
        short = functools.partial(discovery.discover, 0.5, group)
        monkeypatch.setattr("camtopod.cli.cameras.discover", short, raising=False)
        yield camera


def test_discover_lists_cameras_and_adds_them_with_a_user(
    network: OnvifCamera, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "camtopod.toml"
    assert main(["init", "--discover", "--out", str(out)]) == exits.DONE
    said = capsys.readouterr().err
    assert "127.0.0.1  ACME Dome D-42" in said
    assert "next: camtopod init --discover --user NAME" in said
    assert not out.exists()

    (tmp_path / "password").write_text(PASSWORD + "\n")
    add = ["init", "--discover", "--user", USER, "--password-file", str(tmp_path / "password")]
    assert main([*add, "--out", str(out)]) == exits.DONE
    [name] = [path.name for path in (tmp_path / "secrets").iterdir()]
    assert f"[cameras.{name}]" in out.read_text()
    stored = (tmp_path / "secrets" / name).read_text()
    assert stored == f"rtsp://{LOGIN}@127.0.0.1/3?a=1\n"
    assert PASSWORD not in capsys.readouterr().err

    assert main([*add, "--out", str(out)]) == exits.DONE
    assert f"{name}  is in {out} already" in capsys.readouterr().err


def test_a_camera_that_refuses_is_left_out(
    network: OnvifCamera, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "camtopod.toml"
    given = [f"bad=onvif://viewer:wrong@{network.address}", "good=rtsp://127.0.0.1/9"]
    assert main(["init", *given, "--out", str(out)]) == exits.INPUT
    assert "bad  left out: the camera refuses the user name" in capsys.readouterr().err
    assert "[cameras.good]" in out.read_text()
    assert "[cameras.bad]" not in out.read_text()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--user", "x"], "belong together"),
        (["--discover", "--user", "x"], "belong together"),
        ([], "find some with --discover"),
        (["my cam=rtsp://192.0.2.1/"], "my cam=rtsp://192.0.2.1/: a name has 1 to 64"),
    ],
)
def test_usage(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", *arguments]) == exits.USAGE
    assert said in capsys.readouterr().err
