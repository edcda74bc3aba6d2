"""`init` and `check --probe`: cameras that are there and that are not, their names, and where their
passwords go.
"""

from __future__ import annotations

import json
import socket
import sys
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from rendered_scenes import FPS, Person, Scene, line
from serving import camtopod, free_endpoint, small_config

from bench.support.rtsp_streams import Host, hang_up, rtsp_answer, silent
from camtopod import redact
from camtopod.cli.cameras import probe as probes
from camtopod.cli.cameras.naming import named_sources
from camtopod.cli.main import main
from camtopod.config import Config, config_file
from camtopod.serve.daemon import Daemon
from camtopod.vision.settings import VisionSettings
from camtopod.vision.source.capture import IMAGE_WIDTH_MAX
from camtopod.vision.source.probe import Probe
from camtopod.web import pictures

QUICK = VisionSettings()
PASSWORD = "p@ss:w/0rd"


@pytest.fixture(autouse=True)
def _forget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(redact, "_secrets", set())


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds of nobody."""
    return Scene([]).film(tmp_path_factory.mktemp("film") / "yard.mp4", 3.0)


def painted(
    path: Path, size: tuple[int, int], fps: float, colour: tuple[int, int, int] = (90, 90, 90)
) -> Path:
    """A film of this size, of one colour (blue, green, red)."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, size)
    for _ in range(5):
        writer.write(np.full((size[1], size[0], 3), colour, np.uint8))
    writer.release()
    return path


def probed(sources: dict[str, str]) -> dict[str, Probe]:
    settings = Config(vision=QUICK).new_camera
    cameras = {
        name: msgspec.structs.replace(settings, source=source) for name, source in sources.items()
    }
    return probes.probe_all(cameras, lambda name, probe: None)


def everything_below(folder: Path) -> dict[str, tuple[int, str]]:
    """Mode and content of each file."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {
        str(path.relative_to(folder)): (path.stat().st_mode & 0o777, path.read_text())
        for path in files
    }


# --- what a source is ----------------------------------------------------------------------------


def test_a_file_and_what_could_be_better_about_it(film: Path, tmp_path: Path) -> None:
    huge = painted(tmp_path / "huge.mp4", (2560, 1440), 2.0)
    assert IMAGE_WIDTH_MAX < 2560
    good, bad, none = probed(
        {"good": str(film), "bad": str(huge), "none": str(tmp_path / "x.mp4")}
    ).values()
    assert good == Probe("", "MPEG-4", 192, 144, FPS)
    assert good.lines == ["MPEG-4, 192x144, 7 frames a second"]
    assert (bad.problem, bad.width, bad.fps) == ("", 2560, 2.0)
    assert [remark.partition(":")[0] for remark in bad.remarks] == [
        "the picture has hardly any contrast",
        "the frame rate is so low that fast walkers are missed",
        "the picture is larger than needed",
    ]
    assert none == Probe("No such file or directory")


def test_what_is_wrong_with_a_stream_is_said_in_words(tmp_path: Path) -> None:
    hosts = {
        "secret": Host(rtsp_answer("401 Unauthorized")),
        "other": Host(rtsp_answer("404 Not Found")),
        "silent": Host(silent),
        "shy": Host(hang_up),
    }
    with socket.socket() as reserved:
        reserved.bind(("127.0.0.1", 0))  # bound, not listening
        away = f"rtsp://127.0.0.1:{reserved.getsockname()[1]}/x"
        sources = {
            **{name: host.url for name, host in hosts.items()},
            "away": away,
            "device": "4242",
        }
        found = probed(sources)
    for host in hosts.values():
        host.close()
    assert list(found) == list(sources)
    assert {
        name: probe.problem.removeprefix("cannot be opened: ") for name, probe in found.items()
    } == {
        "secret": "the camera refuses the user name or password (401)",
        "other": "the camera has no such stream (404)",
        "silent": "the host does not answer",
        "shy": "the host closes the connection: is it a camera's port?",
        "away": "nothing listens at this address and port",
        "device": "/dev/video4242 does not exist",
    }


def test_a_process_that_hangs_or_crashes_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probes, "START_SECONDS", 0.01 - probes.PROBE_SECONDS_MAX)
    assert probed({"a": "0"}) == {"a": Probe("no answer within 0 s")}
    monkeypatch.setattr(probes, "START_SECONDS", 30.0)
    monkeypatch.setattr(probes, "PROGRAM", "camtopod.none_such")
    assert probed({"a": "0"})["a"].problem.endswith("ended with status 1")


# --- names ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "name"),
    [
        ("rtsp://admin:p@ss:w/rd@192.0.2.10/Streaming/Channels/101", "192-0-2-10"),
        ("rtsp://localhost:7441/JHeOzLkM0NvTzhGq", "localhost"),
        ("/data/some clip.mp4", "some-clip"),
        ("0", "device-0"),
        ("rtsp://[oops/x", "camera"),
        ("rtsp://daemon/x", "daemon-2"),
        ("rtsp://" + 80 * "a", 59 * "a"),
    ],
)
def test_a_camera_is_called_after_its_host_or_file(source: str, name: str) -> None:
    assert named_sources([source]) == {name: source}
    config_file.parse(f'[cameras.{name}]\nsource = "0"')


def test_names_are_different_and_given_ones_stay() -> None:
    given = ["rtsp://nvr/ch1", "rtsp://nvr/ch2", "rtsp://hall/", "hall=rtsp://x/y"]
    assert list(named_sources(given)) == ["nvr", "nvr-2", "hall-2", "hall"]


# --- the command ---------------------------------------------------------------------------------


def test_passwords_go_into_files_of_their_own(
    film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "yard.mp4").write_bytes(film.read_bytes())
    host = Host(rtsp_answer("401 Unauthorized"))
    url = host.url.replace("p@ssw0rd", PASSWORD)
    parameter = "rtsp://127.0.0.1:1/dvr?user=admin&password=hunter2&channel=1"
    token = "rtsp://127.0.0.1:1/stream/JHeOzLkM0NvTzhGq/live"
    (tmp_path / "site").mkdir()
    arguments = [
        "init",
        "yard.mp4",
        f"front.door={url}",
        f"dvr={parameter}",
        f"nvr={token}",
        "--out",
        "site/camtopod.toml",
    ]
    assert main(["--site", "hq", *arguments]) == 66
    host.close()
    out, err = capsys.readouterr()
    assert out == ""
    assert "front.door  cannot be opened: the camera refuses the user name or password (401)" in err
    assert "yard  MPEG-4, 192x144, 7 frames a second" in err
    assert err.endswith(
        "next: camtopod --config site/camtopod.toml up, then open http://127.0.0.1:8780/\n"
    )
    files = everything_below(tmp_path / "site")
    assert files.pop("camtopod.toml")[0] & 0o444
    assert files == {
        "secrets/front.door": (0o600, f"{url}\n"),
        "secrets/dvr": (0o600, f"{parameter}\n"),
        "secrets/nvr": (0o600, f"{token}\n"),
    }
    assert (tmp_path / "site/secrets").stat().st_mode & 0o777 == 0o700
    written = (tmp_path / "site/camtopod.toml").read_text()
    for text in (written, err):
        assert PASSWORD not in text
        assert "w/0rd" not in text
        assert "hunter2" not in text
        assert "JHeOzLkM0NvTzhGq" not in text
    assert "# MPEG-4, 192x144, 7 frames a second\n" in written
    loaded = config_file.load(tmp_path / "site/camtopod.toml")
    assert (loaded.site.name, loaded.cameras["yard"].source) == ("hq", str(tmp_path / "yard.mp4"))
    assert loaded.for_camera("front.door").cameras["front.door"].source == url
    assert main(["check", "site/camtopod.toml"]) == 0


def test_services_are_handed_every_source(
    film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """LoadCredential= of the unit names each file; a service with a missing file does not start."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "yard.mp4").write_bytes(film.read_bytes())
    (tmp_path / "site").mkdir()
    url = f"rtsp://user:{PASSWORD}@127.0.0.1:1/x"
    arguments = ["init", "--credentials", f"hall={url}", "yard.mp4", "--out", "site/camtopod.toml"]
    assert main(arguments) == 66
    err = capsys.readouterr().err
    assert (
        "systemctl enable --now camtopod camtopod-web camtopod-grab@hall camtopod-grab@yard\n"
        in err
    )
    assert (
        f"    CREDENTIALS_DIRECTORY={tmp_path}/site/secrets camtopod check site/camtopod.toml --probe\n"
        in err
    )
    files = everything_below(tmp_path / "site")
    mode, text = files.pop("camtopod.toml")
    assert (mode, PASSWORD in text) == (0o644, False)
    assert files == {
        "secrets/hall": (0o600, f"{url}\n"),
        "secrets/yard": (0o600, f"{tmp_path}/yard.mp4\n"),
    }
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path / "site" / "secrets"))
    loaded = config_file.load(tmp_path / "site/camtopod.toml")
    assert loaded.health.listen == "127.0.0.1:8787"
    assert loaded.for_camera("hall").cameras["hall"].source == url
    assert main(["check", "site/camtopod.toml"]) == 0
    assert "chmod" not in capsys.readouterr().err


@pytest.fixture
def opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in, where each camera can be opened."""
    monkeypatch.setattr(probes, "_probe", lambda *_: Probe("", "H.264", 640, 480, 15.0))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_nothing_is_overwritten_unless_told(
    opened: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["init", "lobby=rtsp://u:first@h/x"]) == 0
    before = everything_below(opened)
    assert set(before) == {"camtopod.toml", "secrets/lobby"}

    assert main(["init", "lobby=rtsp://other/x"]) == 1
    assert "camtopod.toml has cameras.lobby already" in capsys.readouterr().err
    assert main(["init", "lobby=rtsp://u:second@h/x", "--out", "other.toml"]) == 1
    assert "secrets/lobby: exists already; overwrite with --force" in capsys.readouterr().err
    assert everything_below(opened) == before

    assert main(["init", "--force", "lobby=rtsp://u:second@h/x"]) == 0
    assert everything_below(opened)["secrets/lobby"] == (0o600, "rtsp://u:second@h/x\n")


@pytest.mark.parametrize("options", [[], ["--credentials"]])
def test_what_is_printed_leaves_nothing_behind(
    options: list[str],
    opened: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    for stream in (sys.stdin, sys.stderr):
        monkeypatch.setattr(stream, "isatty", lambda: True)
    texts = set()
    for out in ("-", "-", "/proc/self/fd/1"):
        url = f"rtsp://u:{PASSWORD}{len(texts)}@h/x"
        assert main(["init", f"lobby={url}", "--out", out, *options]) == 0
        text, said = capfd.readouterr()
        texts.add(text)
        assert "standard output has lobby\nnot stored: the sources of lobby, which belong" in said
        assert "next, with it stored as camtopod.toml" in said
    assert [*opened.iterdir()] == [], "and nobody is asked for pictures"
    [text] = texts
    assert config_file.parse(text).cameras.keys() == {"lobby"}
    assert PASSWORD not in text


def test_cameras_are_added_to_a_file_whose_rest_stays(
    opened: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = opened / "camtopod.toml"
    mine = (
        '# mine\r\n[site]\r\nname = "hq"   # ours\r\n[cameras.lobby]\r\nsource = "rtsp://h/1"\r\n'
        "min_height = 0.1\r\n[vision]\r\nanalysed_fps = 9.0 # slow"
    )
    out.write_bytes(mine.encode())
    out.chmod(0o640)

    assert main(["init", "hall=rtsp://u:p@h/2", "rtsp://gate/3"]) == 0

    assert out.read_bytes().decode().startswith(mine)
    assert out.stat().st_mode & 0o777 == 0o640
    loaded = config_file.load(out)
    assert list(loaded.cameras) == ["lobby", "hall", "gate"]
    assert (loaded.site.name, loaded.cameras["lobby"].min_height) == ("hq", 0.1)
    assert (opened / "secrets" / "hall").read_text() == "rtsp://u:p@h/2\n"
    assert "camtopod.toml has hall, gate\n" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("written", "status", "said"),
    [
        ("[site]\nnmae = 1\n", 78, "camtopod.toml:2: site.nmae"),
        ('cameras = {a = {source = "0"}}\n', 78, "write cameras as tables"),
        ("[cameras.b]\nsource = '0'\n", 1, "has cameras.b already"),
        ("\udcff", 78, "not UTF-8"),
    ],
)
def test_a_file_that_cannot_be_added_to_stays(
    written: str, status: int, said: str, opened: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    raw = written.encode(errors="surrogateescape")
    Path("camtopod.toml").write_bytes(raw)

    assert main(["init", "b=rtsp://u:p@h/2"]) == status
    assert said in capsys.readouterr().err
    assert Path("camtopod.toml").read_bytes() == raw
    assert not Path("secrets").exists()


def test_sources_from_standard_input_and_a_daemon_elsewhere(tmp_path: Path) -> None:
    out = tmp_path / "c.toml"
    command = ["--connect", "tcp/192.0.2.1:7447", "init", "-", "--out", str(out)]
    process = camtopod(*command, stdin=-1, stderr=-1)
    _, err = process.communicate(b"\nlobby=4242\n  4243  \n", timeout=60)
    assert process.returncode == 66
    assert err.decode().endswith(f"next: camtopod --config {out} grab\n")
    loaded = config_file.load(out)
    assert ({name: each.source for name, each in loaded.cameras.items()}, loaded.bus.connect) == (
        {"lobby": "4242", "device-4243": "4243"},
        ("tcp/192.0.2.1:7447",),
    )


# --- pictures ------------------------------------------------------------------------------------


def test_a_picture_is_kept_when_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    colour = (200, 120, 40)
    yard = painted(tmp_path / "yard.mp4", (2560, 1440), 7.0, colour)
    folder = tmp_path / "state" / "pictures"
    arguments = ["init", str(yard), "gone=4242", "--pictures", str(folder)]

    assert main(arguments) == 66
    assert [path.name for path in folder.iterdir()] == ["yard.jpg"], "and nothing beside it"
    picture = cv2.imread(str(folder / "yard.jpg"))
    assert picture is not None
    assert picture.shape == (720, 1280, 3)
    assert np.abs(picture.mean((0, 1)) - np.array(colour)).max() < 10, "in colour"
    assert (folder / "yard.jpg").stat().st_mode & 0o777 == 0o640
    assert folder.stat().st_mode & 0o777 == 0o750
    assert pictures.picture_of(folder, "yard") == folder / "yard.jpg"

    loaded = config_file.load(tmp_path / "camtopod.toml")
    assert loaded.web.pictures_folder == folder
    assert 'pictures = "state/pictures"\n' in (tmp_path / "camtopod.toml").read_text()
    (folder / "yard.jpg").write_bytes(b"old")
    assert main(["check", "--probe"]) == 66
    assert cv2.imread(str(folder / "yard.jpg")) is not None, "renewed"

    (tmp_path / "camtopod.toml").unlink()
    assert main(arguments) == 1, "it may be the operator's own"
    assert "yard.jpg: exists already; overwrite with --force" in capsys.readouterr().err


def test_the_picture_is_the_scene_without_people(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    walker = Person(line(0.0, (0.3, 0.7), (1.05, 0.7), 6.0))
    Scene([walker]).film(tmp_path / "yard.mp4", 12.0)
    Scene([walker]).film(tmp_path / "short.mp4", 3.0)
    assert main(["init", "yard.mp4", "short.mp4", "--pictures", "pictures"]) == 0
    said = capsys.readouterr().err
    assert "probing 2 cameras ...\n" in said
    assert "  yard  MPEG-4, 192x144, 7 frames a second\n" in said
    assert (
        "7 frames a second; the scene has not settled within 3 s, so its picture may show" in said
    )

    picture, empty = cv2.imread("pictures/yard.jpg"), Scene([], noise=0.0).picture(0.0)
    assert picture is not None
    assert np.abs(picture.mean(axis=2) - empty).max() < 30
    assert Path("pictures/short.jpg").stat().st_size > 1000


@pytest.mark.parametrize(("answer", "kept"), [("", ["yard.jpg"]), ("n", [])])
def test_on_a_terminal_it_asks_once(
    answer: str,
    kept: list[str],
    film: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    answers = [answer]
    for stream in (sys.stdin, sys.stderr):
        monkeypatch.setattr(stream, "isatty", lambda: True)
    monkeypatch.setattr("builtins.input", answers.pop)
    assert main(["init", f"yard={film}"]) == 0
    said = capsys.readouterr().err
    assert "It shows the empty scene and stays on this machine. [Y/n]" in said
    assert said.endswith("next: camtopod up, then open http://127.0.0.1:8780/\n")
    assert [path.name for path in tmp_path.glob("pictures/*")] == kept
    assert main(["init", f"hall={film}"]) == 0, "the answer holds for further cameras"
    assert len([*tmp_path.glob("pictures/*")]) == 2 * len(kept)


# --- check --probe -------------------------------------------------------------------------------


def test_check_probe_opens_the_cameras_and_the_bus(
    film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "c.toml"
    with Daemon(small_config(tmp_path / "state")) as daemon:
        path.write_text(
            f'[bus]\nconnect_seconds = 0.5\nconnect = ["{daemon.endpoint}"]\n'
            f"[cameras.yard]\nsource = {json.dumps(str(film))}\n"
        )
        assert main(["check", str(path), "--probe"]) == 0
        err = capsys.readouterr().err
        assert f"{path}:4: cameras.yard: MPEG-4, 192x144, 7 frames a second\n" in err
        assert f"{path}: bus: connected to {daemon.endpoint}, site site\n" in err

        with path.open("a") as file:
            file.write('[cameras.gone]\nsource_file = "none"\n[cameras.away]\nsource = "4242"\n')
        assert main(["check", str(path), "--probe"]) == 66
        err = capsys.readouterr().err
        assert f"{path}:6: cameras.gone: cannot read {tmp_path}/none: No such file" in err
        assert f"{path}:8: cameras.away: cannot be opened: /dev/video4242 does not exist" in err

        path.write_text(f'[site]\nname = "other"\n[bus]\nconnect = ["{daemon.endpoint}"]\n')
        assert main(["check", str(path), "--probe"]) == 69
        assert ", but no daemon of site other is there" in capsys.readouterr().err


def test_check_probe_before_the_first_start_finds_nothing_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "c.toml"
    here = free_endpoint()
    away = '[bus]\nconnect = ["tcp/127.0.0.1:1"]\nconnect_seconds = 0.1\n'
    for text, status, said, warned in (
        (f'[bus]\nlisten = ["{here}"]\nconnect_seconds = 0.1\n', 0, f"begins it at {here}", False),
        (away, 69, "cannot reach", True),
    ):
        path.write_text(text)
        assert main(["check", str(path), "--probe"]) == status
        err = capsys.readouterr().err
        assert said in err
        assert ("no authentication" in err) is warned
