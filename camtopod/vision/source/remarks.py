"""Remarks on a source: limits of its use and possible improvements, as sentences."""

from __future__ import annotations

import re

import cv2
import numpy as np

from camtopod.vision.detect import Luma
from camtopod.vision.settings import VisionSettings
from camtopod.vision.source.capture import IMAGE_WIDTH_MAX, Capture
from camtopod.vision.source.ffmpeg_log import DAMAGED
from camtopod.vision.source.frame_times import StampClock
from camtopod.vision.source.source_url import scheme_of

FPS_MIN = 4.5
"""Frame rate below which fast walkers are hardly detected."""
CONTRAST_MIN = 3.0
"""Standard deviation of the luma (of 255) below which an image shows nothing."""
OBSERVED_SECONDS = 10.0
"""Time over which frames of a stream are counted and compared.

A camera's noise, and each keyframe, changes some pixel meanwhile.
"""
RTSP_RECORDING = (
    "it is a recording, not a stream: make a file of it by ffmpeg -rtsp_transport tcp -i URL "
    "-c copy film.mkv, and give the file"
)
"""What is said of a recorder's playback, which would be played again with each connection."""
_PLAYBACK = re.compile(r"[?&](start|begin)_?time=", re.IGNORECASE)
"""Part of URLs by which recorders are asked for the past."""


class Playback:
    """Tells whether connections play the same again, as those to a recording do.

    Two pictures of a camera are never the same, unless it is frozen, or they show nothing: a
    connection may begin with black or grey ones.
    """

    def __init__(self) -> None:
        self._first: Luma | None = None
        self._start = 0.0
        self._is_long = False
        """True if pictures came for `OBSERVED_SECONDS` and differ from the first."""
        self._begins = True

    def begin(self) -> None:
        """Begin a connection."""
        self._begins = True

    def repeats(self, t: float, luma: Luma) -> bool:
        """Take a picture (H, W) at ``t`` (seconds); True if it begins what was played before."""
        is_same = self._first is not None and np.array_equal(luma, self._first)
        if not self._begins:
            self._is_long |= t - self._start >= OBSERVED_SECONDS and not is_same
            return False
        if contrast(luma) < CONTRAST_MIN:
            return False
        self._begins = False
        if self._is_long and is_same:
            return True
        self._first, self._start, self._is_long = luma, t, False
        return False


class Observed:
    """The frames of an open source, and what could be better about them."""

    def __init__(self, capture: Capture, settings: VisionSettings) -> None:
        self.codec = capture.codec
        self.size = capture.size
        """Width and height, pixels."""
        self.fps = 0.0
        """Frame rate as measured; 0.0 if not known yet."""
        self.remarks: list[str] = []
        """What could be better, by the latest `OBSERVED_SECONDS`; empty if nothing or not known."""
        self._capture = capture
        self._width_min = settings.working_width / 2
        """Width (pixels) below which people can hardly be detected."""
        self._latest: float | None = None
        self._luma: Luma | None = None
        self._begin()

    def _begin(self) -> None:
        """Begin to count and compare."""
        self.seconds = 0.0
        """Time that has been observed since the remarks, seconds."""
        self._frames = 0
        self._contrast: float | None = None
        """Contrast of the picture that has most; None if none was decoded."""
        self._has_compared = self._has_changed = False

    def add(self, t: float, luma: Luma | None) -> None:
        """Take a frame at ``t`` (seconds) into account; ``luma`` (H, W) if it was decoded."""
        if self._latest is not None:
            self._frames += 1
            self.seconds += min(t - self._latest, OBSERVED_SECONDS)  # a file may pause
        self._latest = t
        if luma is not None:
            if self._luma is not None:
                self._has_compared = True
                self._has_changed = self._has_changed or not np.array_equal(luma, self._luma)
            self._contrast = max(self._contrast or 0.0, contrast(luma))
            self._luma = luma
        if self.seconds >= OBSERVED_SECONDS:
            self.judge()

    def judge(self) -> None:
        """Make the remarks, by the frames since the last time."""
        self.fps = round(self._frames / self.seconds, 3) if self.seconds else 0.0
        consequence = "fast walkers are missed" if self.fps >= 1.0 else "people cannot be followed"
        remarks = {
            "the picture has hardly any contrast: is the lens covered?": (
                self._contrast is not None and self._contrast < CONTRAST_MIN
            ),
            f"the frame rate is so low that {consequence}: set the camera to 5 frames a second or "
            "more, unless this machine is too busy": (0.0 < self.fps < FPS_MIN),
            "the picture is larger than needed: "
            "a smaller stream of the camera takes less of this machine's capacity": (
                max(self.size) > IMAGE_WIDTH_MAX
            ),
            "the picture is so small that people can hardly be detected": (
                self.size[0] < self._width_min
            ),
            f"the picture has not changed for {self.seconds:.0f} s: is the camera frozen?": (
                self._has_compared and not self._has_changed and self.seconds >= OBSERVED_SECONDS
            ),
            "frames are damaged again and again, as when packets are lost: use TCP, or set the "
            "camera to shorter keyframe distances": (self._capture.is_often_damaged),
        }
        self.remarks = [remark for remark, holds in remarks.items() if holds]
        self._begin()


def contrast(luma: Luma) -> float:
    """Return the standard deviation of a picture (H, W), grey levels."""
    return float(cv2.meanStdDev(luma)[1][0, 0])


def is_rtsp(source: str) -> bool:
    """Return True for the URL of a stream by RTSP."""
    return scheme_of(source).startswith("rtsp")


def no_frame(capture: Capture) -> str:
    """Return why an open source may give no frame."""
    if capture.fault not in ("", DAMAGED):
        return f"{capture.fault} ({capture.codec})"
    if capture.is_jpeg:
        return "no JPEG picture comes: give another URL of the camera, such as its RTSP stream"
    has_data = capture.fault or capture.size == (0, 0)
    return "data come, but no keyframe yet" if has_data else "no data come, or no keyframe yet"


def no_stream(source: str, capture: Capture, frames: int, clock: StampClock) -> str:
    """Return what an open URL is if it is no stream, after so many frames; "" if it may be one."""
    may_be_file = not is_rtsp(source)
    if not may_be_file and (capture.seconds or _PLAYBACK.search(source)):
        return RTSP_RECORDING
    if frames == 1 or (may_be_file and 0.0 < capture.seconds * capture.fps < 2.0):
        return "it gives a single picture: give the camera's RTSP or MJPEG stream instead"
    if may_be_file and (capture.seconds or clock.outran):
        return "it is a recording, not a stream: download it, and give the file"
    return ""
