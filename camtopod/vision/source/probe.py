"""A look at a source for some seconds: what it is, and in words what is wrong with it. A process of
its own:

    python -m camtopod.vision.source.probe

reads `Question` from standard input and writes `Probe` to standard output, both as JSON.
"""

from __future__ import annotations

import os
import sys
import time

import cv2
import msgspec
from msgspec import Struct

from camtopod.vision.settings import VisionSettings
from camtopod.vision.source.capture import Capture
from camtopod.vision.source.ffmpeg_log import Complaints, listening
from camtopod.vision.source.recorded import RecordedSource
from camtopod.vision.source.source_url import kind_of

LOOK_SECONDS = 2.0
"""So long frames are counted, after the first one."""
FILE_FRAMES = 50
"""So many of a file are read."""
FPS_MIN = 4.5
"""Fewer frames a second, and who walks fast is hardly seen."""
PIXELS_MAX = 1920 * 1080
"""Of a larger picture decoding alone takes much of a small machine."""
WIDTH_MIN = 160
CONTRAST_MIN = 3.0
"""Standard deviation of the luma, of 255; a picture with less shows nothing."""
PICTURE_WIDTH_MAX = 1280
"""Of the picture that is kept, pixels; to draw zones on, more is of no use."""
_CODECS = {
    "avc1": "H.264",
    "h264": "H.264",
    "hev1": "H.265",
    "hevc": "H.265",
    "hvc1": "H.265",
    "mjpg": "MJPEG",
    "fmp4": "MPEG-4",
    "mp4v": "MPEG-4",
    "vp09": "VP9",
    "av01": "AV1",
}


class Question(Struct):
    """What to look at, and how; ``picture``: whether one is wanted."""

    source: str
    settings: VisionSettings
    picture: bool = False


class Probe(Struct):
    """What was seen. ``problem``: why it cannot be watched, "" if it can; ``remarks``: what could
    be better; ``picture``: its last frame as JPEG, b"" unless asked for.
    """

    problem: str = ""
    codec: str = ""
    width: int = 0
    height: int = 0
    fps: float = 0.0
    remarks: list[str] = []
    picture: bytes = b""

    @property
    def words(self) -> list[str]:
        """For people, for example ``H.264, 1920x1080, 25 frames a second``; or the problem; then
        the remarks.
        """
        rate = f"{self.fps:.3g} frames a second" if self.fps else "unknown frame rate"
        return [self.problem or f"{self.codec}, {self.width}x{self.height}, {rate}", *self.remarks]


def probe(
    source: str, settings: VisionSettings, complaints: Complaints, picture: bool = False
) -> Probe:
    """Open it and count its frames. Takes at most the timeouts and `LOOK_SECONDS`; nothing is
    raised.
    """
    kind = kind_of(source)
    path = source.removeprefix("file://")
    if kind == "file":
        try:
            RecordedSource(path, settings, 0.0, None).close()
        except OSError as error:
            return Probe(error.strerror or str(error).removeprefix(f"{path}: "))
    capture = Capture(path, settings, colour=picture)
    try:
        if not capture.is_open:
            why = _of_device(source) if kind == "device" else complaints.take()
            return Probe(f"it cannot be opened{why and ': '}{why}")
        seen = _watched(capture, live=kind != "file")
        return (
            msgspec.structs.replace(seen, picture=capture.jpeg(PICTURE_WIDTH_MAX))
            if picture
            else seen
        )
    finally:
        capture.release()


def _watched(capture: Capture, live: bool) -> Probe:
    stamps: list[float] = []
    arrivals: list[float] = []
    contrast = 0.0
    while (
        arrivals[-1] - arrivals[0] < LOOK_SECONDS
        if live and arrivals
        else len(arrivals) < FILE_FRAMES
    ):
        grab = capture.grab()
        if grab is None:
            break
        stamps.append(grab.stamp)
        arrivals.append(time.monotonic())
        picture = capture.retrieve()
        if picture is not None:
            contrast = max(contrast, float(picture.std()))
    if not arrivals:
        return Probe("it opens, but no picture comes")
    times = stamps if stamps[-1] > stamps[0] else arrivals
    fps = (len(times) - 1) / (times[-1] - times[0]) if live and len(times) > 1 else capture.fps
    width, height = capture.size
    seen = Probe(
        "", _CODECS.get(capture.codec.lower(), capture.codec or "unknown codec"), width, height, fps
    )
    return msgspec.structs.replace(seen, remarks=_remarks(seen, contrast))


def _remarks(seen: Probe, contrast: float) -> list[str]:
    remarks = []
    if contrast < CONTRAST_MIN:
        remarks.append("the picture is of one colour: is something before the lens?")
    if 0.0 < seen.fps < FPS_MIN:
        remarks.append(
            "so few frames a second that people who walk fast are missed: set 5 or more in the camera"
        )
    if seen.width * seen.height > PIXELS_MAX:
        remarks.append(
            "larger than is of use: a second, smaller stream of the camera takes less of this machine"
        )
    if seen.width < WIDTH_MIN:
        remarks.append("so small that people can hardly be seen")
    return remarks


def _of_device(number: str) -> str:
    """Why a device cannot be opened."""
    path = f"/dev/video{int(number)}"
    if not os.path.exists(path):
        return f"there is no {path}"
    if not os.access(path, os.R_OK | os.W_OK):
        return f"no permission for {path}; this user has to be in the group video"
    return f"{path} is in use, or no camera"


def decoders() -> list[str]:
    """What OpenCV's build says of the libraries that decode video, a line each."""
    video = cv2.getBuildInformation().partition("Video I/O:")[2].partition("\n\n")[0]
    return [
        f"OpenCV {cv2.__version__}",
        *(line.strip() for line in video.splitlines() if line.strip()),
    ]


if __name__ == "__main__":
    asked = msgspec.json.decode(sys.stdin.buffer.read(), type=Question)
    with listening() as heard:
        answer = probe(asked.source, asked.settings, heard, asked.picture)
    sys.stdout.buffer.write(msgspec.json.encode(answer))
