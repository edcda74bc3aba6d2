"""Files as recorders and people leave them: names, pipes, and pictures that are none."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from msgspec.structs import replace
from rendered_scenes import Person, Scene, line
from serving import camtopod

from camtopod.cli.main import main
from camtopod.codec import event_from_json
from camtopod.records import Event
from camtopod.vision import pipeline
from camtopod.vision.settings import VisionSettings
from camtopod.vision.source.ffmpeg_log import captured_log
from camtopod.vision.source.probe import ProbeRequest, probe

SECONDS = 7.5
REAL = cv2.VideoCapture
needs_ffmpeg = pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="no ffmpeg")


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a film in which somebody walks through."""
    people = [Person(line(1.8, (-0.05, 0.55), (1.05, 0.5), 4.0), tall=0.3)]
    return Scene(people).film(tmp_path_factory.mktemp("film") / "film.mp4", SECONDS)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin sooner."""
    monkeypatch.setattr(pipeline, "BOOTSTRAP_SECONDS", 1.0)


def grab(source: Path | str, out: Path) -> tuple[int, list[Event]]:
    """Return exit status and events of ``camtopod grab``."""
    out.touch()
    status = main(["grab", "--camera", "cam", str(source), "--out", str(out)])
    return status, [event_from_json(event) for event in out.read_bytes().splitlines()]


@pytest.mark.parametrize("name", ["12:00:00.mp4", "http:a%20b#?|.mp4", os.fsdecode(b"caf\xe9.mp4")])
def test_a_file_may_have_any_name(
    name: str, film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(film, name)
    status, events = grab(name, tmp_path / "out")
    assert (status, [event.kind for event in events]) == (0, ["entry", "exit"])


@pytest.mark.parametrize("url", ["file://{}", "file://localhost{}", "FILE://{}"])
def test_a_file_may_be_a_url(url: str, film: Path, tmp_path: Path) -> None:
    shutil.copy(film, tmp_path / "my film.mp4")
    assert len(grab(url.format(tmp_path / "my%20film.mp4"), tmp_path / "out")[1]) == 2


def test_what_is_no_file_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / "pipe")
    for source, said in (
        (tmp_path / "pipe", "a pipe cannot be read"),
        ("-", "standard input cannot be read"),
        ("/dev/null", "not a video device"),
    ):
        assert grab(source, tmp_path / "out") == (66, [])
        assert said in capsys.readouterr().err


class Faulty:
    """OpenCV's capture of a real film, in which some calls are other ones."""

    def __init__(self, *arguments: Any) -> None:
        self._capture = REAL(*arguments)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._capture, name)


class Unconverted(Faulty):
    """Pictures that FFmpeg cannot convert: OpenCV calls them good all the same."""

    def retrieve(self, *arguments: Any) -> Any:
        os.write(1, b"[OPENCV:FFMPEG:16] Cannot convert interlaced to progressive frames\n")
        return self._capture.retrieve(*arguments)


def test_pictures_that_are_none_are_not_analysed(
    film: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("cv2.VideoCapture", Unconverted)
    assert grab(film, tmp_path / "out") == (66, [])
    assert "no frame in it can be decoded (MPEG-4): interlaced" in capsys.readouterr().err


class Undecodable(Faulty):
    """A codec for which there is no decoder."""

    def grab(self) -> bool:
        os.write(1, b"[OPENCV:FFMPEG:16] Your platform doesn't support hardware accelerated AV1\n")
        return False


def test_what_cannot_be_decoded_is_said_by_grab_and_init(
    film: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("cv2.VideoCapture", Undecodable)
    assert grab(film, tmp_path / "out") == (66, [])
    assert "(MPEG-4): there is no decoder for it" in capsys.readouterr().err
    with captured_log() as log:
        problem = probe(ProbeRequest(str(film), VisionSettings()), log).problem
    assert problem.endswith("(MPEG-4): there is no decoder for it")


class Damaged(Faulty):
    """A part that cannot be read, after which the file goes on."""

    lost = 7
    grabs = 0

    def grab(self) -> bool:
        self.grabs += 1
        return self._capture.grab() and not 7 < self.grabs <= 7 + self.lost


class Lossy(Faulty):
    """Pictures with an error now and then, of which FFmpeg tells; others follow from them."""

    spacing = 15
    grabs = 0

    def grab(self) -> bool:
        self.grabs += 1
        if self.grabs % self.spacing == 0:
            os.write(1, b"[OPENCV:FFMPEG:16] error while decoding MB 5 3, bytestream -7\n")
        return self._capture.grab()


@pytest.mark.parametrize(("faults", "lost"), [(Damaged, 7), (Lossy, 3)])
def test_damage_does_not_end_a_file(
    faults: type[Faulty],
    lost: int,
    film: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("cv2.VideoCapture", faults)
    status, events = grab(film, tmp_path / "out")
    assert (status, [event.kind for event in events]) == (0, ["entry", "exit"])
    said = capsys.readouterr().err.splitlines()[-1]
    assert "warning: camera cam has ended: 7.4 s of 7.4 s read" in said
    assert f"{52 - lost} pictures analysed, {lost} could not be decoded, 1 entry, 1 exit" in said


@pytest.mark.parametrize("spacing", [4, 40])
def test_that_pictures_are_damaged_again_and_again_is_said(
    spacing: int,
    film: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(Lossy, "spacing", spacing)
    monkeypatch.setattr("cv2.VideoCapture", Lossy)
    assert len(grab(film, tmp_path / "out")[1]) == 2
    said = capsys.readouterr().err
    assert f" {52 // spacing} could not be decoded" in said
    assert ("damaged again and again" in said) == (spacing == 4)


def test_a_file_that_was_cut_ends_early(
    film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    writer = cv2.VideoWriter(
        str(tmp_path / "whole.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 5, (320, 240)
    )
    for _ in range(20):
        writer.write(np.full((240, 320, 3), 99, np.uint8))
    writer.release()
    whole = (tmp_path / "whole.avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(whole[: len(whole) // 2])
    assert grab(tmp_path / "cut.avi", tmp_path / "out")[0] == 0
    assert " of 4.0 s read (the video ends early" in capsys.readouterr().err


def test_a_file_that_is_still_being_written_is_said_to_be(
    film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "film.mp4"
    said = "it is still being written: read it when that has ended"
    for data, status in ((b"", 66), (b"no video\n", 66), (film.read_bytes(), 0)):
        with path.open("wb") as file:
            file.write(data)
            file.flush()
            assert grab(path, tmp_path / "out")[0] == status
            assert said in capsys.readouterr().err
    assert grab(path, tmp_path / "out")[0] == 0
    assert said not in capsys.readouterr().err


@needs_ffmpeg
@pytest.mark.parametrize("seconds", [86400, 1764338400])
def test_a_file_s_stamps_may_begin_anywhere(
    seconds: int, film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A Matroska file declares a duration that counts from the stamp 0 on."""
    path = tmp_path / "film.mkv"
    command = f"ffmpeg -nostdin -loglevel error -i {film} -c copy -output_ts_offset {seconds}"
    subprocess.run([*command.split(), str(path)], check=True)
    status, events = grab(path, tmp_path / "out")
    assert (status, [event.kind for event in events]) == (0, ["entry", "exit"])
    assert "has ended: 7.4 s of 7.4 s read, " in capsys.readouterr().err


def test_what_could_be_better_is_said_of_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "slow.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 2, (64, 48))
    for _ in range(6):
        writer.write(np.full((48, 64, 3), 99, np.uint8))
    writer.release()
    assert grab(path, tmp_path / "out")[0] == 0
    said = capsys.readouterr().err
    for remark in ("hardly any contrast", "the frame rate is so low", "the picture is so small"):
        assert remark in said


def ahead(stamp: float, number: int) -> float:
    return stamp + 95443e3 * (20 <= number <= 22)


def sticking(stamp: float, number: int) -> float:
    return stamp if number < 20 else max(stamp, 6000 + number / 90)


def begins_anew(stamp: float, number: int) -> float:
    return stamp if number < 20 else stamp - 2000


def paused(stamp: float, number: int) -> float:
    return stamp + (100e3 if number >= 10 else 0)


def unstamped(stamp: float, number: int) -> float:
    return stamp if number % 9 == 2 else 0.0  # the first picture in each packet of a recorder's


def test_a_file_without_stamps_is_read_at_its_declared_rate(
    film: Path,
    plain: list[Event],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Unstamped(Faulty):
        def get(self, of: int) -> float:
            return 0.0 if of == cv2.CAP_PROP_POS_MSEC else self._capture.get(of)

    monkeypatch.setattr("cv2.VideoCapture", Unstamped)
    events = grab(film, tmp_path / "out")[1]
    assert [event.t for event in events] == pytest.approx([event.t for event in plain], abs=0.1)
    assert "no time stamps, so 7 frames a second are assumed" in capsys.readouterr().err


@pytest.fixture(scope="module")
def plain(film: Path) -> list[Event]:
    """Return the events of the film with its own stamps."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline, "BOOTSTRAP_SECONDS", 1.0)
        return grab(film, film.with_name("plain"))[1]


@pytest.mark.parametrize("wrong", [ahead, sticking, begins_anew, paused, unstamped])
def test_a_stamp_is_believed_as_far_as_the_rate_bears_it_out(
    wrong: Callable[[float, int], float],
    film: Path,
    plain: list[Event],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Stamped(Faulty):
        grabs = 0

        def grab(self) -> bool:
            self.grabs += 1
            return self._capture.grab()

        def get(self, of: int) -> float:
            value = self._capture.get(of)
            return wrong(value, self.grabs) if of == cv2.CAP_PROP_POS_MSEC else value

    monkeypatch.setattr("cv2.VideoCapture", Stamped)
    found = grab(film, tmp_path / "out")[1]
    if wrong is paused:  # truly: the video stands still for 100 s, as of one who records movement
        plain = [replace(event, t=event.t + 100) for event in plain]
    assert [event.t for event in found] == pytest.approx([event.t for event in plain], abs=0.2)


def made(film: Path, options: str) -> Path:
    """Return a film made of ``film`` with options of ffmpeg."""
    path = film.with_name("made.ts")
    command = f"ffmpeg -nostdin -loglevel error -y -i {film} {options}"
    subprocess.run([*command.split(), str(path)], check=True)
    return path


@needs_ffmpeg
def test_interlaced_video_is_refused_in_words(film: Path) -> None:
    fields = "-flags +ilme+ildct -vf tinterlace=interleave_top,setfield=tff"
    path = made(film, f"-c:v mpeg2video {fields}")
    with camtopod(
        "grab", "--camera", "c", str(path), "--out", "-", stderr=subprocess.PIPE
    ) as grabber:
        said = grabber.communicate(timeout=60)[1]
    assert grabber.returncode == 66
    assert b"interlaced video cannot be read" in said


@needs_ffmpeg
def test_video_that_begins_long_after_the_sound_is_read(film: Path, tmp_path: Path) -> None:
    sound = "-f lavfi -i sine=d=15 -c:a mp2"
    path = made(film, f"{sound} -vf setpts=PTS+7/TB -c:v mpeg2video -b:v 4M")
    status, events = grab(path, tmp_path / "out")
    assert (status, len(events)) == (0, 2)
