"""Write drawn pictures to a file on this machine: a video, or one picture that is replaced.

Both are readable by their owner alone from the first byte on, and an older file is replaced whole.
Nothing is flushed to the disk: these files are for viewing and need not survive a power cut.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import disk_usage

import cv2

PICTURE_SECONDS = 2.0
"""Time after which a single picture is replaced, seconds."""
VIDEO_FPS = 10
"""Frames per second of a video; frames are repeated or left out to keep the time of the camera."""
GAP_SECONDS_MAX = 2.0
"""Longest time without frames (seconds) that lasts as long in a video; of a longer one nothing is
seen.
"""
LAST_SECONDS = 3.0
"""Time for which a video holds its last picture, seconds."""
FREE_BYTES_MIN = 64 << 20
"""Free bytes of a disk below which nothing more is written: the rest is for the spool."""
_MODE = 0o600
_CODEC = "mp4v"

Picture = cv2.typing.MatLike
"""Colour picture (H, W, 3), uint8: blue, green, red."""


class ShowError(Exception):
    """The file cannot be written; ``str()`` names it, says why and what to do."""


def open_shown_file(path: Path) -> PictureFile | VideoFile:
    """Return the file for the kind of its suffix. Raises `ShowError` if it cannot be written."""
    if path.suffix not in (".mp4", ".jpg", ".png"):
        raise ShowError(f"{path}: the name has to end in .mp4 (a video), .jpg or .png (a picture)")
    if path.is_dir():
        raise ShowError(f"{path} is a directory: name a file")
    return VideoFile(path) if path.suffix == ".mp4" else PictureFile(path)


class PictureFile:
    """One picture, replaced every `PICTURE_SECONDS`."""

    def __init__(self, path: Path) -> None:
        """Make sure that the file can be written; an older one stays until the first picture."""
        self._path = path
        self._due = float("-inf")
        _require_writable(path)

    def wants(self, t: float, now: float) -> bool:
        """Return True if `PICTURE_SECONDS` have passed."""
        return now >= self._due

    def write(self, t: float, now: float, picture: Picture) -> None:
        """Replace the picture whole or not at all."""
        self._due = now + PICTURE_SECONDS
        self.finish(picture)

    def finish(self, picture: Picture) -> None:
        """Replace the picture for the last time."""
        _replace(self._path, cv2.imencode(self._path.suffix, picture)[1].tobytes())


class VideoFile:
    """A video in the time of the camera, however fast it is read. It cannot be played before
    `finish`.
    """

    def __init__(self, path: Path) -> None:
        """Make sure that the file can be written; an older one stays until the first picture."""
        self._path = path.absolute()  # a name with a colon would be a protocol to FFmpeg
        self._writer: cv2.VideoWriter | None = None
        self._size = (0, 0)
        self._latest: Picture | None = None
        self._start = 0.0
        """Capture time of the video's beginning, less gaps, seconds."""
        self._frames = 0
        _require_writable(path)

    def wants(self, t: float, now: float) -> bool:
        """Return True if the video has no frame of that time yet."""
        return self._writer is None or self._slot(t) >= self._frames

    def write(self, t: float, now: float, picture: Picture) -> None:
        """Add a picture, and before it repeat the last one until its time."""
        if self._writer is None or self._latest is None:
            self._open(t, picture)
        else:
            while self._frames < self._slot(t):
                self._add(self._latest)
        self._latest = picture
        self._add(picture)

    def finish(self, picture: Picture) -> None:
        """Hold the last picture for a while, and complete the video."""
        for _ in range(round(LAST_SECONDS * VIDEO_FPS)):
            self._add(picture)
        assert self._writer is not None
        self._writer.release()

    def _slot(self, t: float) -> int:
        """Return the frame of the video that shows time ``t``; leaves out a gap in the frames."""
        slot = round((t - self._start) * VIDEO_FPS)
        if slot - self._frames > GAP_SECONDS_MAX * VIDEO_FPS:
            self._start = t - self._frames / VIDEO_FPS
            return self._frames
        return slot

    def _open(self, t: float, picture: Picture) -> None:
        """Replace an older file and begin the video."""
        height, width = picture.shape[:2]
        self._start = t
        self._size = (width, height)
        _replace(self._path, b"")

        # FFmpeg fills the file that is there, so the permissions stay.
        code = cv2.VideoWriter.fourcc(*_CODEC)
        self._writer = cv2.VideoWriter(str(self._path), cv2.CAP_FFMPEG, code, VIDEO_FPS, self._size)
        if not self._writer.isOpened():
            raise ShowError(f"cannot write {self._path}: this OpenCV cannot write such a video")

    def _add(self, picture: Picture) -> None:
        """Add a frame. OpenCV does not say if that fails, so the space is checked before."""
        assert self._writer is not None
        with _failing(self._path):
            _require_space(self._path)
        if picture.shape[1::-1] != self._size:  # the camera has changed its format
            picture = cv2.resize(picture, self._size, interpolation=cv2.INTER_AREA)
        self._writer.write(picture)
        self._frames += 1


@contextmanager
def _failing(path: Path) -> Iterator[None]:
    """Turn an `OSError` of the block into a `ShowError`."""
    try:
        yield
    except OSError as error:
        raise ShowError(f"cannot write {path}: {error.strerror}") from None


def _require_writable(path: Path) -> None:
    """Raise `ShowError` if a new file cannot be created beside ``path``."""
    with _failing(path):
        _create(_beside(path), b"")
        _beside(path).unlink()


def _replace(path: Path, content: bytes) -> None:
    """Replace a file whole or not at all. Raises `ShowError`."""
    with _failing(path):
        _require_space(path)
        _create(_beside(path), content)
        os.replace(_beside(path), path)


def _beside(path: Path) -> Path:
    """Return the name of a new file before it takes the place of ``path``."""
    return path.with_name(f".{path.name}.new")


def _create(path: Path, content: bytes) -> None:
    """Write a new file that its owner alone can read, whole or not at all. Raises `OSError`."""
    path.unlink(missing_ok=True)
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, _MODE)
    try:
        with os.fdopen(fd, "wb") as file:
            file.write(content)
    except OSError:
        path.unlink()
        raise


def _require_space(path: Path) -> None:
    """Raise `ShowError` if the disk is nearly full."""
    if disk_usage(path.parent).free < FREE_BYTES_MIN:
        raise ShowError(
            f"cannot write {path}: less than {FREE_BYTES_MIN >> 20} MiB of the disk are free"
        )
