"""What the grabber sees, drawn into a video or an image."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from rendered_scenes import FPS, Person, Scene, line

from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import VisionSettings
from camtopod.vision.show import Preview, ShowError, overlay, shown_file
from camtopod.vision.show.shown_file import SHOWN_SECONDS, Image, open_shown_file

GREY = np.full((48, 64, 3), 99, np.uint8)
SETTINGS = VisionSettings(
    ignore=(((0.0, 0.0), (0.2, 0.0), (0.2, 0.2)),), doors=(((0.5, 0.5),), ((0.8, 0.1),) * 3)
)


@pytest.fixture(autouse=True)
def _open_umask() -> Iterator[None]:
    before = os.umask(0)
    yield
    os.umask(before)


def shown(path: Path, seconds: float) -> list[str]:
    """Show one passage; return the kinds of its events."""
    preview = Preview(path, "cam", SETTINGS)
    pipeline = ViewPipeline("cam", SETTINGS, preview)
    scene, events = Scene([Person(line(5.0, (-0.05, 0.7), (1.05, 0.5), 6.0))]), []
    for k in range(round(seconds * FPS)):
        events += pipeline.process(1e9 + k / FPS, scene.picture(k / FPS))
    events += pipeline.finish()
    preview.close()
    return [event.kind for event in events]


def frames(path: Path) -> list[Image]:
    video, found = cv2.VideoCapture(str(path)), []
    while (got := video.read())[0]:
        found.append(got[1])
    return found


def count(image: Image, colour: overlay.Colour) -> int:
    """Return how many pixels have about this colour."""
    near = np.abs(image.astype(int) - colour).max(axis=2) < 60
    return int(near.sum())


def test_a_video_shows_tracks_events_and_areas_in_the_camera_s_time(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "film.mp4"
    path.write_text("an older file")
    path.chmod(0o644)
    assert shown(path, 14.0) == ["entry", "exit"]
    assert caplog.messages == []
    assert path.stat().st_mode & 0o777 == 0o600
    assert [one.name for one in tmp_path.iterdir()] == ["film.mp4"]

    film = frames(path)
    assert len(film) / FPS == pytest.approx(14.0 + SHOWN_SECONDS, abs=0.3)
    assert film[0].shape[1] == overlay.WIDTH
    assert film[0].shape[0] % 2 == 0
    empty, walking, entered = (film[round(FPS * t)] for t in (2.0, 8.2, 6.6))
    assert count(walking, overlay._OBJECT) > count(empty, overlay._OBJECT) + 500
    assert count(entered, overlay._ENTRY) > count(empty, overlay._ENTRY) + 200
    assert count(empty, overlay._IGNORED) > 200
    assert count(empty, overlay._DOOR) > 80


def test_a_portrait_camera_is_shown_whole_at_the_size_of_a_screen(tmp_path: Path) -> None:
    preview = Preview(tmp_path / "now.png", "cam", SETTINGS)
    pipeline = ViewPipeline("cam", SETTINGS, preview)
    for k in range(round(4 * FPS)):
        pipeline.process(k / FPS, np.full((640, 360), 120, np.uint8))
    preview.close()
    height, width = cv2.imread(str(tmp_path / "now.png")).shape[:2]
    assert width == overlay.WIDTH, "room for the words"
    assert height <= 1080 * 1.05


def test_an_image_is_replaced_now_and_then(tmp_path: Path) -> None:
    name = "now.jpg"
    file = open_shown_file(tmp_path / name, FPS)

    assert list(tmp_path.iterdir()) == [], "nothing before the first image"
    file.write(100.0, GREY)
    first = os.stat(tmp_path / name)
    assert first.st_mode & 0o777 == 0o600
    assert [file.wants(t) for t in (101.0, 101.9, 102.0)] == [False, False, True]
    file.write(102.0, GREY // 2)
    assert os.stat(tmp_path / name).st_ino != first.st_ino, "a new file in its place"
    file.finish(102.5, GREY // 3)
    picture = cv2.imread(str(tmp_path / name))
    assert picture is not None
    assert (picture.shape, round(float(picture.mean()))) == (GREY.shape, 33)
    assert [one.name for one in tmp_path.iterdir()] == [name]


def test_files_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "folder.mp4").mkdir()
    (tmp_path / "file").write_text("")
    for name, why in (
        ("folder.mp4", "is a directory"),
        ("x.avi", "has to end in .mp4"),
        ("x", "has to end in .mp4"),
        ("none/x.mp4", "No such file or directory"),
        ("none/x.jpg", "No such file or directory"),
        ("file/x.png", "Not a directory"),
    ):
        with pytest.raises(ShowError, match=why):
            open_shown_file(tmp_path / name, FPS)


def test_a_full_disk_ends_the_picture_with_one_warning_and_no_event(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    name = "v.mp4"
    free = iter([1 << 30] * 30)
    monkeypatch.setattr(
        shown_file, "disk_usage", lambda folder: SimpleNamespace(free=next(free, 1 << 20))
    )

    assert shown(tmp_path / name, 14.0) == ["entry", "exit"]
    assert caplog.messages == [
        f"--show: cannot write {tmp_path / name}: less than 64 MiB of the disk are free; "
        "it is not written any more, events go on"
    ]
    assert [one.name for one in tmp_path.iterdir()] == [name]
    assert len(frames(tmp_path / name)) == 29, "what was written can be played"
