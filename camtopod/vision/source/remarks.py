"""Remarks on a source: limits of its use and possible improvements, as sentences."""

from __future__ import annotations

import os
import re

import numpy as np

from camtopod.vision.detect import Luma
from camtopod.vision.source.capture import Capture
from camtopod.vision.source.ffmpeg_log import DAMAGED, FfmpegLog
from camtopod.vision.source.frame_times import StampClock
from camtopod.vision.source.source_url import device_number

FPS_MIN = 4.5
"""Frame rate below which fast walkers are hardly detected."""
FPS_FOLLOWED = 1.0
"""Frame rate below which people are not followed: they are elsewhere in the next picture."""
PIXELS_MAX = 1920 * 1080
"""Number of pixels above which decoding alone takes much of a small machine's capacity."""
WIDTH_MIN = 160
"""Width (pixels) below which people can hardly be detected."""
CONTRAST_MIN = 3.0
"""Standard deviation of the luma (of 255) below which a picture shows nothing."""
OBSERVED_SECONDS = 10.0
"""Time over which pictures of a stream are counted and compared.

A camera's noise, and each keyframe, changes some pixel meanwhile.
"""
_SCHEMES = ("rtsp", "rtsps", "rtmp", "rtmps", "http", "https", "tcp", "udp", "rtp", "srt")
"""Schemes of streams."""
_OTHERS = {
    "onvif": "`camtopod init` asks a camera for its streams by ONVIF: give what it finds",
    "v4l2": "give a device by its number, or as /dev/video0",
}
"""Advice on URLs that are no streams, by scheme."""


SINGLE_PICTURE = "it gives a single picture: give the camera's RTSP or MJPEG stream instead"
RECORDING = "it is a recording, not a stream: download it, and give the file"


def remarks(size: tuple[int, int], fps: float, contrast: float) -> list[str]:
    """Return what could be better about a source that works.

    size: width and height, pixels.
    fps: frame rate; 0.0 if unknown.
    contrast: standard deviation of the luma.
    """
    found = []
    width, height = size
    if contrast < CONTRAST_MIN:
        found.append("the picture has hardly any contrast: is the lens covered?")
    if 0.0 < fps < FPS_MIN:
        lost = "fast walkers are missed" if fps >= FPS_FOLLOWED else "people cannot be followed"
        found.append(
            f"the frame rate is so low that {lost}: set the camera to 5 frames a second or more"
        )
    if width * height > PIXELS_MAX:
        found.append(
            "the picture is larger than needed: "
            "a smaller stream of the camera takes less of this machine's capacity"
        )
    if width < WIDTH_MIN:
        found.append("the picture is so small that people can hardly be detected")
    return found


class Observed:
    """The pictures of a source that runs, and what could be better about them."""

    def __init__(self, size: tuple[int, int]) -> None:
        self._size = size
        self._latest: float | None = None
        self._luma: Luma | None = None
        self._begin()
        self.words = ""
        """What could be better, by the latest `OBSERVED_SECONDS`; "" if nothing or not known."""

    def _begin(self) -> None:
        """Begin to count and compare."""
        self._seconds = 0.0
        self._frames = 0
        self._contrast = 0.0
        self._changed = False

    def add(self, arrival: float, luma: Luma | None) -> None:
        """Take a frame into account; ``luma`` (H, W) if it was decoded."""
        if self._latest is not None:
            self._frames += 1
            self._seconds += min(arrival - self._latest, OBSERVED_SECONDS)  # a file may pause
        self._latest = arrival
        if luma is not None:
            self._changed |= self._luma is not None and not np.array_equal(luma, self._luma)
            self._contrast = max(self._contrast, float(luma.std()))
            self._luma = luma
        if self._seconds >= OBSERVED_SECONDS:
            self.judge()

    def judge(self) -> None:
        """Say what could be better, by the frames since the last time."""
        fps = self._frames / self._seconds if self._seconds > 0.0 else 0.0
        found = remarks(self._size, fps, self._contrast)
        if not self._changed and self._seconds >= OBSERVED_SECONDS:
            found.append(
                f"the picture has not changed for {self._seconds:.0f} s: is the camera frozen?"
            )
        self.words = "; ".join(found)
        self._begin()


def why_not_opened(source: str, ffmpeg_log: FfmpegLog) -> str:
    """Return why a device or stream could not be opened; "" if that is not known."""
    number = device_number(source)
    if number is not None:
        return _of_device(number)
    scheme, _, rest = source.lower().partition("://")
    if scheme not in _SCHEMES:
        return _OTHERS.get(scheme, f"{scheme}:// is none of {', '.join(_SCHEMES)}")
    reason = ffmpeg_log.newest_reason()
    if not reason and "%" in re.split("[/?]", rest, maxsplit=1)[0].rpartition("@")[2]:
        return "an IPv6 address with a zone may not be understood: give another address"
    return reason


def no_picture(capture: Capture) -> str:
    """Return why an open source may give no picture."""
    if capture.fault not in ("", DAMAGED):
        return f"{capture.fault} ({capture.codec})"
    if capture.fault or capture.size == (0, 0):
        return "data come, but no keyframe yet"
    return "no data come, or no keyframe yet"


def unfit(source: str, capture: Capture) -> str:
    """Return what an open URL is if it is no stream; "" if it is one."""
    if capture.seconds == 0.0 or source.lower().startswith("rtsp"):
        return ""
    if capture.seconds * capture.fps < 2.0:
        return SINGLE_PICTURE
    return f"{RECORDING} (it has {capture.seconds:.0f} s)"


def why_over(source: str, frames: int, clock: StampClock) -> str:
    """Return what a URL is that has ended after so many frames; "" if it may be a stream."""
    if frames == 1:
        return SINGLE_PICTURE
    return RECORDING if clock.outran and not source.lower().startswith("rtsp") else ""


def _of_device(number: int) -> str:
    """Return why a device cannot be opened."""
    path = f"/dev/video{number}"
    if not os.path.exists(path):
        return f"{path} does not exist"
    if not os.access(path, os.R_OK | os.W_OK):
        return f"no permission for {path}: add this user to the group video"
    return f"{path} is in use or is not a camera"
