"""A file, an RTSP stream or a device -> frames with capture times.

What was learned about OpenCV's FFmpeg backend the hard way: name the backend or the timeouts are ignored;
one decoder thread, or a stall first hands out stale frames as good ones; a capture that said False once
spins and never recovers; releasing it from another thread while it reads crashes; without
``rtsp_transport;tcp`` it switches to UDP; the frame rate wanted must be had by skipping `retrieve`, never
`grab`, or the stream falls behind.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import cv2
import numpy as np

from camtopod.vision.background import Luma
from camtopod.vision.settings import VisionSettings
from camtopod.vision.source import kind_of, percent_encoded

STREAM_OPTIONS = "rtsp_transport;tcp|probesize;32768|analyzeduration;300000"
"""A small probe gives the first frame after 0.6 s instead of 1.9 s."""
_OPTIONS_VARIABLE = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
LUMA_CORRELATION_MIN = 0.98
_STEP_RATE = 0.1


class Grab(NamedTuple):
    """A frame that was grabbed: its presentation time in seconds (0.0 where unknown)."""

    stamp: float


class Frame(NamedTuple):
    """A frame that is to be analysed: capture time in seconds and picture (H, W)."""

    t: float
    luma: Luma


class Capture:
    """One opened capture. All calls from one thread; dead after the first failed `grab`."""

    def __init__(self, source: str, settings: VisionSettings) -> None:
        """Open ``source``; see `is_open` for whether that worked. Blocks for at most the open timeout."""
        cv2.utils.logging.setLogLevel(0)  # its messages hold URLs with passwords
        kind = kind_of(source)
        if kind == "device":
            self._capture = cv2.VideoCapture(int(source))
        else:
            parameters = [cv2.CAP_PROP_N_THREADS, 1]
            if kind == "stream":
                parameters += [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, round(1000 * settings.open_timeout_seconds)]
                parameters += [cv2.CAP_PROP_READ_TIMEOUT_MSEC, round(1000 * settings.read_timeout_seconds)]
            with _environment(kind == "stream"):
                name = percent_encoded(source) if kind == "stream" else source
                self._capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, parameters)
        self._luma_only: bool | None = None if kind != "device" else False

    @property
    def is_open(self) -> bool:
        """Whether opening worked (it stays so when the source dies)."""
        return bool(self._capture.isOpened())

    @property
    def fps(self) -> float:
        """What the source says its frame rate is; 0.0 where it does not."""
        fps = float(self._capture.get(cv2.CAP_PROP_FPS))
        return fps if 0.0 < fps < 1000.0 else 0.0

    def grab(self) -> Grab | None:
        """Take the next frame without converting it; None when the source has ended or died."""
        if not self._capture.grab():
            return None
        return Grab(float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0)

    def retrieve(self) -> Luma | None:
        """The grabbed frame's luma (H, W); None if it cannot be decoded."""
        if self._luma_only is None:
            return self._choose_format()
        good, picture = self._capture.retrieve()
        if not good or picture is None:
            return None
        if self._luma_only:
            return picture if picture.ndim == 2 else None
        return _grey(picture)

    def _choose_format(self) -> Luma | None:
        """The luma plane is what decoding yields, and conversion costs more than it; but not all formats
        have one."""
        good, picture = self._capture.retrieve()
        if not good or picture is None:
            return None
        grey = _grey(picture)
        self._capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        try:
            good, luma = self._capture.retrieve()
        except cv2.error:  # a format whose planes it does not know
            good, luma = False, grey
        self._luma_only = bool(good) and luma is not None and _is_luma(luma, grey)
        if self._luma_only:
            return luma
        self._capture.set(cv2.CAP_PROP_CONVERT_RGB, 1)
        return grey

    def release(self) -> None:
        """Close it. From the thread that reads."""
        self._capture.release()


class Cadence:
    """Which frames to analyse: as near to a wanted rate as the source's own allows, by time stamps."""

    def __init__(self, fps: float) -> None:
        self._interval = 1.0 / fps
        self._step = 0.0
        self._last_stamp: float | None = None
        self._last_taken: float | None = None

    def wants(self, stamp: float) -> bool:
        """Whether to analyse the frame with this time stamp, seconds; call it for every frame."""
        if self._last_stamp is not None and stamp > self._last_stamp:
            step = min(stamp - self._last_stamp, 1.0)
            self._step += (step - self._step) * (_STEP_RATE if self._step else 1.0)
        self._last_stamp = stamp
        due = self._last_taken is None or not 0.0 <= stamp - self._last_taken < self._interval - self._step / 2
        if due:
            self._last_taken = stamp
        return due


@contextmanager
def _environment(stream: bool) -> Iterator[None]:
    """FFmpeg's options are read from the environment at opening; a user's own stay."""
    if not stream or _OPTIONS_VARIABLE in os.environ:
        yield
        return
    os.environ[_OPTIONS_VARIABLE] = STREAM_OPTIONS
    try:
        yield
    finally:
        del os.environ[_OPTIONS_VARIABLE]


def _grey(picture: Luma) -> Luma:
    if picture.ndim == 2:
        return picture
    if picture.shape[2] == 1:
        return picture[:, :, 0]
    return np.asarray(cv2.cvtColor(picture[:, :, :3], cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def _is_luma(luma: Luma, grey: Luma) -> bool:
    """Whether the plane handed out without conversion is the picture."""
    if luma.ndim != 2 or luma.shape != grey.shape or luma.dtype != np.uint8:
        return False
    a, b = luma[::4, ::4].astype(np.float64).ravel(), grey[::4, ::4].astype(np.float64).ravel()
    if a.std() < 1.0 or b.std() < 1.0:  # a flat picture says nothing: nor does conversion cost it anything
        return bool(abs(a.mean() - b.mean()) < 20.0 and a.std() < 2.0 and b.std() < 2.0)
    return bool(np.corrcoef(a, b)[0, 1] >= LUMA_CORRELATION_MIN)
