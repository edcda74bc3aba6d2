"""Write drawn images to a file on this machine: a video, or one image that is replaced.

Both are readable by their owner alone from the first byte on, and an older file is replaced whole.
"""

from __future__ import annotations

import errno
from pathlib import Path
from shutil import disk_usage
from tempfile import TemporaryFile

import cv2

from camtopod.files import writing

SHOWN_SECONDS = 2.0
"""Interval at which a single image is replaced, seconds. So that each is seen in it, events and
paths are drawn for as long; a video holds its last image as long, and leaves out longer gaps.
"""
FREE_BYTES_MIN = 64 << 20
"""Free bytes of a disk below which nothing more is written: the rest is for the spool."""
_CODEC = "mp4v"

Image = cv2.typing.MatLike
"""Image in colour (H, W, 3), uint8: blue, green, red."""


class ShowError(Exception):
    """The file cannot be written; ``str()`` names it, says why and what to do."""


def open_shown_file(path: Path, fps: float) -> ImageFile | VideoFile:
    """Return the file for the kind of its suffix; an older one stays until the first image.

    fps: frames per second of a video.

    Raises `ShowError` if it cannot be written.
    """
    if path.suffix not in (".mp4", ".jpg", ".png"):
        raise ShowError(f"{path}: the name has to end in .mp4 (a video), .jpg or .png (an image)")
    if path.is_dir():
        raise ShowError(f"{path} is a directory: name a file")
    try:
        TemporaryFile(dir=path.parent).close()
    except OSError as error:
        raise ShowError(f"cannot write {path}: {error.strerror}") from None
    return VideoFile(path, fps) if path.suffix == ".mp4" else ImageFile(path)


class ImageFile:
    """One image, replaced every `SHOWN_SECONDS`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._due = float("-inf")

    def wants(self, t: float) -> bool:
        """Return True if `SHOWN_SECONDS` have passed."""
        return t >= self._due

    def write(self, t: float, image: Image) -> None:
        """Replace the image whole or not at all. Raises `OSError`."""
        self._due = t + SHOWN_SECONDS
        _replace(self._path, cv2.imencode(self._path.suffix, image)[1].tobytes())

    def finish(self, t: float, image: Image) -> None:
        """Replace the image for the last time. Raises `OSError`."""
        self.write(t, image)


class VideoFile:
    """A video in the time of the camera, however fast it is read. It cannot be played before
    `finish`.
    """

    def __init__(self, path: Path, fps: float) -> None:
        self._path = path.absolute()  # a name with a colon would be a protocol to FFmpeg
        self._fps = fps
        self._writer: cv2.VideoWriter | None = None
        self._due = float("-inf")
        """Capture time of the next frame, seconds."""
        self._latest: Image

    def wants(self, t: float) -> bool:
        """Return True if a frame is due, or nearly."""
        return (t - self._due) * self._fps >= -1 / 2

    def write(self, t: float, image: Image) -> None:
        """Add an image, and before it repeat the last one until its time. Raises `OSError`."""
        if self._writer is None:
            self._writer = self._begun(image)
        if t - self._due > SHOWN_SECONDS:
            self._due = t
        while self.wants(t - 1 / self._fps):
            self._add(self._latest)
        self._latest = image
        self._add(image)

    def finish(self, t: float, image: Image) -> None:
        """Hold the last image for a while, and complete the video. Raises `OSError`."""
        for _ in range(round(SHOWN_SECONDS * self._fps)):
            self._add(image)
        if self._writer is not None:
            self._writer.release()

    def _begun(self, image: Image) -> cv2.VideoWriter:
        """Replace an older file and begin the video."""
        self._size = image.shape[1::-1]
        _replace(self._path, b"")  # FFmpeg fills it, so the permissions stay
        code = cv2.VideoWriter.fourcc(*_CODEC)
        writer = cv2.VideoWriter(str(self._path), cv2.CAP_FFMPEG, code, self._fps, self._size)
        if not writer.isOpened():
            raise OSError(errno.ENOTSUP, "this OpenCV cannot write such a video")
        return writer

    def _add(self, image: Image) -> None:
        """Add a frame. OpenCV does not say if that fails, so the space is checked before."""
        _require_space(self._path)
        assert self._writer is not None
        self._writer.write(cv2.resize(image, self._size))  # the camera may change its format
        self._due += 1 / self._fps


def _replace(path: Path, content: bytes) -> None:
    """Replace a file whole or not at all. Raises `OSError`."""
    _require_space(path)
    with writing(path, 0o600) as file:
        file.write(content)


def _require_space(path: Path) -> None:
    """Raise `OSError` if the disk is nearly full."""
    if disk_usage(path.parent).free < FREE_BYTES_MIN:
        reason = f"less than {FREE_BYTES_MIN >> 20} MiB of the disk are free"
        raise OSError(errno.ENOSPC, reason)
